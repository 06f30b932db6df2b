"""`drone-env submit`: write a submission to the leaderboard."""

import json
from collections.abc import Iterable, Iterator
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import tyro

from drone_env.agents import make_agent
from drone_env.agents.base import begin
from drone_env.commands.arguments import OPTIONAL, ChosenAgent
from drone_env.commands.evaluate import TaskNames, chosen_tasks
from drone_env.commands.printing import progress_bar
from drone_env.commands.verify import verify
from drone_env.core.episode import Episode, rollout
from drone_env.core.seeds import split_seeds
from drone_env.errors import InvalidValueError, needs

Runs = Annotated[tuple[Path, ...], tyro.conf.arg(metavar="DIR"), OPTIONAL]


def submit(
    link: str,
    out: Path,
    agent: ChosenAgent = None,
    runs: Runs = (),
    name: str | None = None,
    task: TaskNames = ("all",),
    maps: int = 100,
) -> None:
    """Write an agent's flights over the first test maps as a file for the leaderboard, and verify it.

    Give an agent, which flies now, or runs of a language model that `drone-env infer --split test` wrote: all of one
    model and prompt, one for each task.

    Example: drone-env submit --agent my_policy:Tipsy --link https://github.com/ME/tipsy --out tipsy.jsonl

    Example: drone-env submit --runs runs/easy runs/hard --link https://huggingface.co/ME/NAME --out mine.jsonl

    Args:
        link: Where readers find the agent: code, weights, a paper, or the transcripts of the runs.
        out: The file to write.
        agent: The agent.
        runs: The runs, instead of an agent.
        name: The name on the leaderboard; the default is that of the agent or the model.
        task: The agent's tasks, or `all`.
        maps: Number of maps of each task. The leaderboard takes 20 to 1,000.
    """
    from drone_env.results.submission import SubmissionHead, write_submission  # loads Pydantic

    if (agent is None) == (not runs):
        raise InvalidValueError("submit takes either --agent or --runs")
    if agent is None:
        with needs("llm"):
            about, flights = _of_runs(runs)
    else:
        about, flights = _of_agent(agent, task, maps)
    given = about | {"link": link} | ({} if name is None else {"agent": name})
    write_submission(out, SubmissionHead.read(json.dumps(given), "not a submission"), flights)
    verify((out,))


def _of_agent(name: str, tasks: TaskNames, maps: int) -> tuple[dict[str, Any], Iterator[Episode]]:
    """Return the head of an agent's submission, and its flights, which are flown when they are read."""
    agents = {task: make_agent(name, task) for task in chosen_tasks(tasks)}

    def flights() -> Iterator[Episode]:
        with progress_bar("maps", maps * len(agents)) as advance:
            for task, seed in product(agents, split_seeds("test", maps)):
                episode = Episode(task, seed=seed)
                rollout(episode, begin(agents[task], name, episode))
                advance(1, task.short_name)
                yield episode

    return {"agent": name, "maps": maps, "tasks": {task.id: task.version for task in agents}}, flights()


def _of_runs(runs: Runs) -> tuple[dict[str, Any], Iterable[Episode]]:
    """Return the head of a submission of runs, and their first flight over each map."""
    from drone_env.llm.answers import Unusable
    from drone_env.llm.run_folder import read_run, turns_of

    read = [read_run(path) for path in runs]
    first, flights = read[0].config, [flight for run in read for flight in run.flights]
    for run in read:
        if (run.config.model, run.config.prompt) != (first.model, first.prompt):
            raise InvalidValueError(f"{run.path} is of another model or prompt than {runs[0]}")
        verdict, reason = run.verdict
        if verdict != "valid" or len(run.counted) < len(run.flights):
            raise InvalidValueError(f"{run.path} is {verdict}, or has errored flights: {reason or 'resume it'}")
    return {
        "agent": first.model,
        "maps": first.seeds[1] - first.seeds[0],
        "tasks": {run.config.task: run.config.task_version for run in read},
        "prompt": first.prompt,
        "unusable": Unusable.among(turns_of(flights)).share,
    }, [flight.episode for flight in flights if flight.repeat == 0]
