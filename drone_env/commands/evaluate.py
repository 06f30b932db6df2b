"""`drone-env evaluate`: agents on the same maps, with the exact optimum."""

import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import tyro

from drone_env import __version__
from drone_env.agents import NETWORK_AGENTS, file_of, make_agent
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
from drone_env.results.evaluate import FIGURES, episodes_key, evaluate_keys, local_engine, repeats_of, summarise
from drone_env.results.result import EpisodesKey, Results, repeated
from drone_env.results.statistics import with_interval
from drone_env.results.tables import Table, number, percent, print_table

CHOICE = "|".join(NETWORK_AGENTS)
TaskNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar=f"all|{TASK}")]
EngineName = Literal["local", "ray"]
JsonFile = Annotated[str | None, tyro.conf.arg(metavar="FILE|-")]
Cannot = CheckpointError | TooLargeError | UnsupportedTaskError
"""The reason why an agent cannot fly a task."""
Grid = dict[TaskConfig, dict[str, Results | Cannot]]
"""By task and agent: the results, or the reason why there are none."""


def evaluate(
    task: TaskNames = ("all",),
    agents: AgentNames = ("random", "greedy", "optimal"),
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
    report = {
        "package": __version__,
        "tasks": {
            t.id: {
                "version": t.version,
                "split": chosen_split,
                "seeds": [maps.start, maps.stop],
                "episodes": len(maps),
                "repeats": repeats,
                "agents": {agent: _figures(cell) for agent, cell in row.items()},
            }
            for t, row in flown.items()
        },
    }
    if write_report(report, json):
        _print(report)


def _figures(cell: Results | Cannot) -> dict[str, Any]:
    return summarise(cell) if isinstance(cell, Results) else {**dict.fromkeys(FIGURES), "unsupported": str(cell)}


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

    Raises:
        UnknownNameError, InvalidValueError, OSError: for invalid names, seeds, files and folders.
        CheckpointError, TooLargeError, UnsupportedTaskError: if no agent, or not the agent of a file, can fly any task.
        ClusterError: from the cluster.
        AgentError: if an agent fails.
    """
    if not tasks or not agents:
        raise InvalidValueError("--task and --agents take one name or more")
    if address is not None and engine != "ray":
        raise InvalidValueError("--address names a cluster: give it with --engine ray")
    chosen = [t for name in tasks for t in (TASKS.values() if name == "all" else [get_task(name)])]
    grid = {t: {a: _cell(t, a, maps, split, repeats) for a in agents} for t in dict.fromkeys(chosen)}
    # At least one agent must support a task, and so must every agent of a file.
    for required in (agents, *([agent] for agent in agents if file_of(agent))):
        cells = [row[agent] for row in grid.values() for agent in required]
        if not any(isinstance(cell, tuple) for cell in cells):
            raise cast(Cannot, cells[0])
    keys = [key for row in grid.values() for cell in row.values() if isinstance(cell, tuple) for key in cell]
    flown = _fly(keys, engine, address, out)
    return {
        t: {a: repeated([flown[key] for key in cell]) if isinstance(cell, tuple) else cell for a, cell in row.items()}
        for t, row in grid.items()
    }


def _cell(task: TaskConfig, name: str, maps: range, split: str, repeats: int) -> tuple[EpisodesKey, ...] | Cannot:
    """Return the keys of an agent on a task, or why it cannot fly it."""
    try:
        if name == "optimal":
            require_solvable(task)
        agent = make_agent(name, task)
        return repeats_of(episodes_key(task, name, maps, split, made=agent), repeats, agent)
    except (TooLargeError, UnsupportedTaskError) as error:
        return error
    except CheckpointError as error:
        if file_of(name) is None:
            raise  # a shipped file is damaged
        return error


def _fly(
    keys: Sequence[EpisodesKey], engine: EngineName, address: str | None, out: Path | None
) -> dict[EpisodesKey, Results]:
    folder = None
    if out is not None:
        from drone_env.results.folder import ResultsFolder  # loads Pydantic

        folder = ResultsFolder(out, keys)
    total = sum(key.seeds[1] - key.seeds[0] for key in keys)
    with progress_bar("maps", total) as advance, noted_interrupts() as interrupts:

        def arrived(chunk: Results) -> None:
            if interrupts:
                raise KeyboardInterrupt
            advance(len(chunk.seeds), f"{get_task(chunk.key.task).short_name} {chunk.key.agent}")

        if engine == "local":
            return evaluate_keys(keys, local_engine, folder, arrived)
        from drone_env.cluster.connect import connect

        with connect(address):
            from drone_env.cluster.episodes import fly_on_nodes

            return evaluate_keys(keys, fly_on_nodes, folder, arrived)


@contextmanager
def noted_interrupts() -> Generator[list[bool], None, None]:
    """Yield a list that contains an entry for each Ctrl-C whose exception a callback of the compiler has lost."""
    noted, hook = list[bool](), sys.unraisablehook
    sys.unraisablehook = lambda lost: noted.append(True) if lost.exc_type is KeyboardInterrupt else hook(lost)
    try:
        yield noted
    finally:
        sys.unraisablehook = hook


def json_file(json: str | None) -> Path | None:
    """Return the file of `--json`; None for standard output and without the option.

    Raises:
        InvalidValueError: if its folder is missing.
    """
    target = None if json in (None, "-") else Path(json)
    if target is not None and (not target.name or target.is_dir() or not target.parent.is_dir()):
        raise InvalidValueError(f"--json takes - or a file in a folder that exists, got {json!r}")
    return target


def write_report(report: dict[str, Any], json: str | None) -> bool:
    """Write a report as `--json` requests, and return whether to print tables too.

    Raises:
        InvalidValueError, OSError: if it cannot be written.
    """
    target = json_file(json)
    if json == "-":
        print_json(report)
    elif target is not None:
        write_json(target, report)
    return json != "-"


def _print(report: dict[str, Any]) -> None:
    head = ("task", "agent", "score (95 %)", "optimum", "ratio", "regret", "success", "steps", "excess")
    rows = [
        (
            f"{get_task(task_id).short_name} v{of_task['version']}",
            agent,
            with_interval(figures["mean_score"], figures["score_ci95"]),
            number(figures["mean_optimal_score"]),
            number(figures["score_ratio"]),
            number(figures["mean_regret"]),
            percent(figures["success_rate"]),
            number(figures["mean_steps"], ".1f"),
            number(figures["mean_excess_steps"], ".2f"),
        )
        for task_id, of_task in report["tasks"].items()
        for agent, figures in of_task["agents"].items()
    ]
    flown = next(iter(report["tasks"].values()))
    start, stop = flown["seeds"]
    caption = f"{stop - start:,} maps a task, split {flown['split']}, seeds {start} to {stop - 1}"
    if flown["repeats"] > 1:
        caption += f", {flown['repeats']} flights of each stochastic agent per map"
    table = Table("Graded score beside the exact optimum of the same maps", head, rows)
    print_table(table, names=2, caption=caption, sections=True)
    for task_id, of_task in report["tasks"].items():
        for agent, figures in of_task["agents"].items():
            if "unsupported" in figures:
                print(f"{get_task(task_id).short_name}, {agent}: {figures['unsupported']}")
