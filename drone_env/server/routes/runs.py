"""The routes that show runs that are kept here, of agents and of language models, and what these were asked."""

from pathlib import Path
from statistics import fmean
from typing import Literal

from fastapi import APIRouter, Request, Response
from pydantic import Field
from starlette.concurrency import run_in_threadpool

from drone_env.agents.named import sb3_elsewhere, sb3_file
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError
from drone_env.llm.answers import ChatMessage
from drone_env.llm.transcript import Failure
from drone_env.models import Count, Message
from drone_env.results.leaderboard import LeaderboardEntry, NotRanked, boards_of
from drone_env.results.result import Result
from drone_env.results.statistics import Bounds
from drone_env.server.jobs import bench
from drone_env.server.problems import RequestError, answers
from drone_env.server.routes.compare import AgentMap
from drone_env.server.state import SharedParts

router = APIRouter(tags=["compare"])
LISTED = 1000
"""Maps of one run that are told: all of an evaluation with the number of maps that it has unless it says another."""


class Run(Message):
    """What an agent or a language model flew over the maps of a board.

    Each flight of a model was checked: it follows from the model's own answers. Of an agent no actions are kept; its
    scores are held to the optima of their maps.
    """

    run: str = Field(description="Name of its folder.")
    kind: Literal["agent", "model"] = Field(description="From `drone-env evaluate`, or from `drone-env infer`.")
    agent: str = Field(description="Who flew: the model, or the agent as `drone-env evaluate` was told it.")
    prompt: str | None = Field(description="What the model was asked by; null of an agent, as the next four.")
    errored: Count | None = Field(description="Flights that were left out, since a request failed for good.")
    waits: Count | None = Field(description="Steps that are a WAIT because no answer could be used.")
    unusable_share: float | None = Field(description="Share of answers that could not be used, after their repair.")
    marked: bool = Field(description="Whether that is more than 5 %: the score says little about the model.")
    tokens: Count | None
    flights: Count = Field(description="Those that count.")
    success_rate: float = Field(ge=0, le=1)
    score: float = Field(ge=0, le=1)
    score_ci95: Bounds = Field(description="Over the maps; null for one.")
    regret: float | None
    normalised: float | None = Field(description="(score - random) / (optimum - random) over the same maps.")
    steps: float = Field(description="Mean length in steps, over the maps.")
    maps: list[AgentMap] = Field(description=f"By number; of more than {LISTED}, those where most was lost.")


class RunBoard(Message):
    """Runs over the same maps, the best first."""

    maps: str = Field(description="Which maps, in words.")
    rows: list[Run]


class UnrankedRun(Message):
    """A run that is not ranked."""

    run: str = Field(description="Name of its folder.")
    reason: str


class RunBoards(Message):
    """The runs over a task that are kept here."""

    task: str = Field(description="Id of the task.")
    boards: list[RunBoard]
    unranked: list[UnrankedRun]


class ModelCall(Message):
    """One request to a language model, and its answer."""

    step: Count = Field(description="The step that it was made for, from 1; that of a whole route is the first.")
    attempt: Count = Field(description="1, or 2 after an answer that could not be used.")
    messages: list[ChatMessage]
    answer: str | None = Field(description="The text or the tool's arguments; null if there was no answer.")
    reasoning: str | None = Field(description="What the model thought, where the endpoint tells it.")
    outcome: str = Field(description="How the answer was understood: `ok`, or why it was no action.")
    failures: list[Failure] = Field(description="Tries that brought no answer.")
    latency: float = Field(ge=0, description="Seconds that the last try took.")


class ModelCalls(Message):
    """All requests of one flight, in order: none where no language model flew it, or its run is not kept here."""

    run: str | None = Field(description="Name of the run's folder; null where there is none, as the next two.")
    model: str | None
    prompt: str | None
    calls: list[ModelCall]


@router.get("/leaderboard/{task_name}/runs", response_model=RunBoards, responses=answers(404, 422, 503))
async def run_boards(request: Request, shared: SharedParts, task_name: str) -> Response:
    """Agents and language models side by side, over the same maps of a task.

    They are the evaluations (`drone-env evaluate --out`) in `evaluations` of the data folder, and the runs of
    `drone-env infer` in `llm`, each flown again from the model's own answers before it is ranked. The first look at one
    takes seconds.
    """
    task = get_task(task_name)
    # One by one: each has the time of a job, and its worker remembers it.
    flights: list[str] = []
    for path in await shared.work(request, _runs_of, task.id):
        flights += await shared.work(request, _check_run, path)
    for path in await shared.work(request, _evaluations):
        await shared.work(request, _check_evaluation, path, task.id)
    stored = await run_in_threadpool(shared.store.stored_ids, flights)
    return Response(await shared.work(request, _boards, task.id, stored), media_type="application/json")


def _runs_of(task: str) -> list[Path]:
    return [path for path, config in bench().runs.configs().items() if config is None or config.task == task]


def _check_run(path: Path) -> list[str]:
    """The ids under which a store may have its flights."""
    ranked = all(isinstance(entry, LeaderboardEntry) for entry in bench().runs.entries(path))
    return [id_ for id_, _ in bench().runs.flights(path)] if ranked else []


def _evaluations() -> list[Path]:
    return bench().evaluations.folders()


def _check_evaluation(path: Path, task: str) -> None:
    bench().evaluations.entries(path, task)


def _boards(task: str, stored: set[str]) -> str:
    found = [entry for path in _runs_of(task) for entry in bench().runs.entries(path)]
    found += [entry for path in _evaluations() for entry in bench().evaluations.entries(path, task)]
    answer = RunBoards(
        task=task,
        boards=[
            RunBoard(maps=board.maps, rows=[_row(entry, stored) for entry in board.rows])
            for board in boards_of(entry for entry in found if isinstance(entry, LeaderboardEntry))
        ],
        unranked=[
            UnrankedRun(run=one.path.name, reason=_without_folder(one.reason, one.path))
            for one in found
            if isinstance(one, NotRanked)
        ],
    )
    return answer.model_dump_json()


def _row(entry: LeaderboardEntry, stored: set[str]) -> Run:
    report, results = entry.report, entry.results
    is_agent = "agent" in report
    # The newest flight over each map that the store has.
    ids = {} if is_agent else {seed: id_ for id_, seed in bench().runs.flights(entry.path) if id_ in stored}
    same = ("score", "score_ci95", "regret", "normalised", "success_rate")
    return Run(
        **{name: report[name] for name in same},
        run=entry.path.name,
        kind="agent" if is_agent else "model",
        agent=_without_place(entry.agent) if is_agent else entry.agent,
        prompt=report["config"].get("prompt"),
        errored=None if is_agent else report["flights"]["errored"],
        waits=report.get("waits"),
        unusable_share=None if is_agent else report["unusable"]["share"],
        marked=not is_agent and report["unusable"]["marked"],
        tokens=None if is_agent else sum(report["tokens"].values()),
        flights=sum(row.flights for row in results.rows()),
        steps=fmean(results.steps),
        maps=[AgentMap.of(row._replace(id=ids.get(row.seed))) for row in _listed(results.rows())],
    )


def _listed(rows: list[Result]) -> list[Result]:
    """As many as a page can show, by number."""
    if len(rows) <= LISTED:
        return rows
    worst = sorted(rows, key=lambda row: row.score - (row.optimum or 1.0))[:LISTED]
    return sorted(worst, key=lambda row: row.seed)


@router.get("/episodes/{episode_id}/calls", response_model=ModelCalls, responses=answers(404, 422, 503))
async def calls(request: Request, shared: SharedParts, episode_id: str) -> Response:
    """What a language model was asked at each step of a flight, and what it answered."""
    found = await shared.work(request, _calls, episode_id)
    if found is None:
        await run_in_threadpool(shared.store.episode, episode_id)
        found = ModelCalls(run=None, model=None, prompt=None, calls=[]).model_dump_json()
    return Response(found, media_type="application/json")


def _calls(episode_id: str) -> str | None:
    try:
        found = bench().runs.calls(episode_id)
    except InvalidValueError:
        # Not the error itself: it names the folder.
        raise RequestError(404, "damaged_run", "the run of this flight is damaged: see drone-env leaderboard") from None
    if found is None:
        return None
    path, config, asked = found
    answer = ModelCalls(
        run=path.name,
        model=config.model,
        prompt=config.prompt,
        calls=[
            ModelCall(
                # A turn is a step: a whole route is planned in the first one.
                step=call.turn,
                attempt=call.attempt,
                messages=call.messages,
                answer=None if call.answer is None else call.answer.tool_arguments or call.answer.text,
                reasoning=None if call.answer is None else call.answer.reasoning,
                outcome=call.outcome,
                failures=call.failures,
                latency=call.latency,
            )
            for call in asked
        ],
    )
    return answer.model_dump_json()


def _without_folder(reason: str, path: Path) -> str:
    """Strangers need not know where the folder is."""
    return " ".join(map(_without_place, reason.replace(str(path), path.name).split(" ")))


def _without_place(agent: str) -> str:
    """Nor where the file of a policy is."""
    file = sb3_file(agent)
    return agent if file is None or not file.is_absolute() else sb3_elsewhere(agent, Path(file.name))
