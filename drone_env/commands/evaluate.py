"""`drone-env evaluate`: agents on the same maps, with the exact optimum."""

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import tyro

from drone_env import __version__
from drone_env.agents import NETWORK_AGENTS, Agent, file_of, make_agent
from drone_env.commands.arguments import (
    TASK,
    AgentNames,
    ClusterAddress,
    SeedRange,
    SplitName,
    select_maps,
)
from drone_env.commands.printing import print_json, progress_bar
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import CheckpointError, InvalidValueError, TooLargeError, UnsupportedTaskError
from drone_env.files import write_json
from drone_env.planning.optimal import require_solvable
from drone_env.results.evaluate import FIGURES, episodes_key, evaluate_keys, figures_of, local_engine, repeats_of
from drone_env.results.result import EpisodesKey, Results, repeated
from drone_env.results.statistics import Summary, with_interval
from drone_env.results.tables import Table, number, percent, print_table

CHOICE = "|".join(NETWORK_AGENTS)
TaskNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar=f"all|{TASK}")]
EngineName = Literal["local", "ray"]
JsonFile = Annotated[str | None, tyro.conf.arg(metavar="FILE|-")]
Cannot = CheckpointError | TooLargeError | UnsupportedTaskError
"""The reason why an agent cannot fly a task."""
Grid = dict[TaskConfig, dict[str, Results | Cannot]]
Summaries = dict[TaskConfig, dict[str, Summary | Cannot]]
"""By task and agent: the results or their statistics, or the reason why there are none."""


def evaluate(
    task: TaskNames = ("all",),
    agents: AgentNames = ("random", "nearest", "beam", "optimal"),
    split: SplitName = None,
    episodes: int | None = None,
    seeds: SeedRange = None,
    json: JsonFile = None,
    checkpoint: Path | None = None,
    out: Path | None = None,
    repeats: int = 1,
    engine: EngineName = "local",
    address: ClusterAddress = None,
) -> None:
    """Fly many maps with several agents and compare their scores with the exact optimum of the same maps.

    Prints a table; a progress bar goes to standard error. Score: graded, 0.01 to 0.99, with its 95 % interval
    over maps, each for itself. Ratio: mean score / mean optimal score. Regret: mean of optimum - score. Excess: steps
    beyond the optimal flight, on delivered maps; negative if the optimal flight spends steps on charging. See
    docs/quoting.md. If an agent cannot fly a task, its row contains dashes, and the reason follows the table.

    Example: drone-env evaluate --task hard --agents greedy optimal --episodes 100 --json results.json

    Args:
        task: One or more tasks; `all` for every registered task.
        agents: One or more agents: names, `MODULE:NAME` for your own agent or a model of
            Stable-Baselines3 and its observation wrapper (docs/agents.md).
        split: Fly the first maps of this split. Default: test. Training never uses validation and test.
        episodes: Number of maps of the split. Default: 1000.
        seeds: Fly maps A to B - 1 instead.
        checkpoint: Use the network in this file (.safetensors) instead of the shipped one, for `pathqnet` or `tournet`.
        json: Write the statistics to this file; - prints only JSON to standard output.
        out: Store the results of each 1,000 maps in this folder; the same command resumes from it.
        repeats: Flights per map of stochastic agents; their mean counts.
        engine: Fly in this process, or on a Ray cluster (extra `cluster`); the results are the same.
        address: The cluster: local starts one on this machine (the default), auto joins the one that runs here,
            HOST:PORT joins another.
    """
    chosen_split, maps = select_maps(seeds, split, episodes, 1000)
    if checkpoint is not None:
        if not set(agents) & set(NETWORK_AGENTS):
            raise InvalidValueError(f"--checkpoint is the network of an agent: name it with --agents {CHOICE}")
        agents = tuple(f"{agent}:{checkpoint}" if agent in NETWORK_AGENTS else agent for agent in agents)
    json_file(json)
    try:
        flown = fly_grid(task, agents, maps, chosen_split, repeats, engine, address, out)
    except KeyboardInterrupt:
        if out is not None:
            print(f"interrupted; the same command goes on from {out}", file=sys.stderr)
        raise
    summaries: Summaries = {
        t: {agent: Summary.of(cell) if isinstance(cell, Results) else cell for agent, cell in row.items()}
        for t, row in flown.items()
    }
    if json is not None:
        write_report(_report(summaries, maps, chosen_split, repeats), json)
    if json != "-":
        _print(summaries, maps, chosen_split, repeats)


def _report(summaries: Summaries, maps: range, split: str, repeats: int) -> dict[str, Any]:
    def figures(cell: Summary | Cannot) -> dict[str, Any]:
        return figures_of(cell) if isinstance(cell, Summary) else {**dict.fromkeys(FIGURES), "unsupported": str(cell)}

    return {
        "package": __version__,
        "tasks": {
            task.id: {
                "version": task.version,
                "split": split,
                "seeds": [maps.start, maps.stop],
                "episodes": len(maps),
                "repeats": repeats,
                "agents": {agent: figures(cell) for agent, cell in row.items()},
            }
            for task, row in summaries.items()
        },
    }


def _print(summaries: Summaries, maps: range, split: str, repeats: int) -> None:
    head = ("task", "agent", "score (95 %)", "optimum", "ratio", "regret", "success", "steps", "excess")
    cells = [(task, agent, cell) for task, row in summaries.items() for agent, cell in row.items()]
    rows = [(f"{task.short_name} v{task.version}", agent, *_columns(cell)) for task, agent, cell in cells]
    caption = f"{len(maps):,} maps a task, split {split}, seeds {maps.start} to {maps.stop - 1}"
    if repeats > 1:
        caption += f", {repeats} flights of each stochastic agent per map"
    table = Table("Graded score beside the exact optimum of the same maps", head, rows)
    print_table(table, names=2, caption=caption, sections=True)
    for task, agent, cell in cells:
        if not isinstance(cell, Summary):
            print(f"{task.short_name}, {agent}: {cell}")


def _columns(cell: Summary | Cannot) -> tuple[str, ...]:
    if not isinstance(cell, Summary):
        return ("-",) * 7
    return (
        with_interval(cell.score, cell.score_ci95),
        number(cell.optimum),
        number(cell.ratio),
        number(cell.regret if cell.regret_maps == cell.maps else None),
        percent(cell.success_rate),
        number(cell.steps, ".1f"),
        number(cell.excess_steps, ".2f"),
    )


def fly_grid(
    tasks: Sequence[str],
    agents: Sequence[str],
    maps: range,
    split: str,
    repeats: int,
    engine: EngineName = "local",
    address: str | None = None,
    out: Path | None = None,
) -> Grid:
    """Fly the same maps of each task with each agent and show a progress bar.

    Args:
        tasks: Names of tasks; `all` for every registered task.
        agents: Names of agents.
        maps: The maps.
        split: The split of the maps, or `custom`.
        repeats: Flights of a stochastic agent over each map.
        engine: Where to fly.
        address: The cluster.
        out: The folder that stores the results.
    """
    if not tasks or not agents:
        raise InvalidValueError("--task and --agents take one name or more")
    if address is not None and engine != "ray":
        raise InvalidValueError("--address names a cluster: give it with --engine ray")
    chosen = [t for name in tasks for t in (TASKS.values() if name == "all" else [get_task(name)])]
    made: dict[tuple[str, str], Agent] = {}

    def keys_of(task: TaskConfig, name: str) -> tuple[EpisodesKey, ...] | Cannot:
        try:
            if name == "optimal":
                require_solvable(task)
            agent = made[task.id, name] = make_agent(name, task)
            return repeats_of(episodes_key(task, name, maps, split, made=agent), repeats, agent)
        except (TooLargeError, UnsupportedTaskError) as error:
            return error
        except CheckpointError as error:
            if file_of(name) is None:
                raise  # a shipped file is damaged
            return error

    grid = {t: {a: keys_of(t, a) for a in agents} for t in dict.fromkeys(chosen)}
    keys = [key for row in grid.values() for cell in row.values() if isinstance(cell, tuple) for key in cell]
    flying = {key.agent for key in keys}
    for agent in agents:  # at least one must support a task, and so must every agent of a file
        if not flying or (agent not in flying and file_of(agent)):
            raise next(cast(Cannot, row[agent]) for row in grid.values())
    flown = _fly(keys, made, engine, address, out)
    return {
        t: {a: repeated([flown[key] for key in cell]) if isinstance(cell, tuple) else cell for a, cell in row.items()}
        for t, row in grid.items()
    }


def _fly(
    keys: Sequence[EpisodesKey],
    agents: dict[tuple[str, str], Agent],
    engine: EngineName,
    address: str | None,
    out: Path | None,
) -> dict[EpisodesKey, Results]:
    folder = None
    if out is not None:
        from drone_env.results.folder import ResultsFolder  # loads Pydantic

        folder = ResultsFolder(out, keys)
    total = sum(key.seeds[1] - key.seeds[0] for key in keys)
    with progress_bar("maps", total) as advance:

        def arrived(chunk: Results) -> None:
            advance(len(chunk.seeds), f"{chunk.key.task} {chunk.key.agent}")

        if engine == "local":
            return evaluate_keys(keys, partial(local_engine, agents=agents), folder, arrived)
        from drone_env.cluster.connect import connect

        with connect(address):
            from drone_env.cluster.episodes import fly_on_nodes

            return evaluate_keys(keys, fly_on_nodes, folder, arrived)


def json_file(json: str | None) -> Path | None:
    """Return the file of `--json`; None for standard output and without the option."""
    target = None if json in (None, "-") else Path(json)
    if target is not None and (not target.name or target.is_dir() or not target.parent.is_dir()):
        raise InvalidValueError(f"--json takes - or a file in a folder that exists, got {json!r}")
    return target


def write_report(report: dict[str, Any], json: str) -> None:
    """Write a report to the file of `--json`, or to standard output."""
    target = json_file(json)
    if target is None:
        print_json(report)
    else:
        write_json(target, report)
