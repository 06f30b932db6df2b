"""`drone-env evaluate`: agents side by side on the same maps, beside the exact optimum."""

import contextlib
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from drone_env import __version__
from drone_env.agents import NETWORK_AGENTS, network_file
from drone_env.agents.weights_file import network_of
from drone_env.commands.arguments import SHORT_NAMES, AgentNames, ClusterAddress, SeedRange, SplitName, chosen_maps
from drone_env.commands.printing import print_json, progress_bar
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import CheckpointError, InvalidValueError, TooLargeError, UnsupportedTaskError
from drone_env.evaluation.episodes import EpisodeResults, EpisodesKey, episodes_key, summarise
from drone_env.evaluation.folder import Engine, ResultsFolder, evaluate_keys, local_engine
from drone_env.files import write_json
from drone_env.reports.tables import Table, number, percent, print_table, with_margin

TaskNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar=f"all|{'|'.join(SHORT_NAMES)}")]
CHOICE = "|".join(NETWORK_AGENTS)
JsonFile = Annotated[str | None, tyro.conf.arg(metavar="FILE|-")]

Cell = EpisodesKey | CheckpointError | TooLargeError | UnsupportedTaskError
"""What an agent is to fly of a task, or why it cannot."""


def evaluate(
    task: TaskNames = ("all",),
    agents: AgentNames = ("random", "greedy", "optimal"),
    split: SplitName = None,
    episodes: int | None = None,
    seeds: SeedRange = None,
    json: JsonFile = None,
    checkpoint: Path | None = None,
    out: Path | None = None,
    engine: Literal["local", "ray"] = "local",
    address: ClusterAddress = None,
) -> None:
    """Fly many maps with several agents and compare them, each beside the exact optimum of the same maps.

    Prints a table; a progress bar goes to standard error. Score: graded, 0.01 to 0.99, with its 95 % confidence
    interval. Ratio: mean score / mean optimal score. Regret: mean of optimum less score. Excess: steps beyond the
    optimal flight, on delivered maps; below zero where the best flight takes its time to charge. docs/quoting.md says
    what of it to quote. An agent that cannot fly one of several tasks has a row of dashes there, and the reason below.

    Example: drone-env evaluate --task hard --agents greedy optimal --episodes 100 --json results.json

    Args:
        task: One or more tasks, or all.
        agents: One or more agents.
        split: Whose first maps to fly: test if nothing is said. Training never touches validation and test.
        episodes: How many maps of the split, 1000 if nothing is said.
        seeds: Fly the maps from A up to and not including B instead of a split's.
        checkpoint: Fly by the network in this file (.npz) instead of the shipped one: `pathqnet`, or `tournet`, as the
            file says.
        json: Write the figures to this file; - prints only the JSON on standard output.
        out: Keep the results of each 1,000 maps in this folder as they arrive; the same command goes on from there.
        engine: Fly in this process, or on a Ray cluster (extra `cluster`); the figures are the same.
        address: The cluster: local starts one on this machine (if nothing is said), auto joins the one that runs here,
            HOST:PORT joins that one.
    """
    chosen_split, maps = chosen_maps(seeds, split, episodes, 1000)
    if not task or not agents:
        raise InvalidValueError("--task and --agents take one name or more")
    if checkpoint is not None:
        agents = _by_checkpoint(agents, checkpoint)
    target = None if json in (None, "-") else Path(json)
    if target is not None and (not target.name or target.is_dir() or not target.parent.is_dir()):
        raise InvalidValueError(f"--json takes - or a file in a folder that exists, got {json!r}")
    named = [t for name in task for t in (TASKS.values() if name == "all" else [get_task(name)])]
    cells = {t: {agent: _cell(t, agent, maps, chosen_split) for agent in agents} for t in dict.fromkeys(named)}
    _check_that_some_fly(cells)

    if address is not None and engine != "ray":
        raise InvalidValueError("--address names a cluster: give it with --engine ray")
    all_keys = [cell for row in cells.values() for cell in row.values() if isinstance(cell, EpisodesKey)]
    folder = None if out is None else ResultsFolder(out, all_keys)
    try:
        with _engine(engine, address) as chosen_engine:
            results = _fly_all(all_keys, chosen_engine, folder)
    except KeyboardInterrupt:
        if out is not None:
            print(f"interrupted; to go on, give the same options with --out {out}", file=sys.stderr)
        raise
    summaries = {key: summarise(of_key) for key, of_key in results.items()}
    nothing = dict.fromkeys(summaries[all_keys[0]])
    figures = {
        t.id: {
            "version": t.version,
            "split": chosen_split,
            "seeds": [maps.start, maps.stop],
            "episodes": len(maps),
            "agents": {
                agent: summaries[cell] if isinstance(cell, EpisodesKey) else {**nothing, "unsupported": str(cell)}
                for agent, cell in row.items()
            },
        }
        for t, row in cells.items()
    }
    report = {"package": __version__, "tasks": figures}
    if json == "-":
        print_json(report)
        return
    if target is not None:
        write_json(target, report)
    _print(report)


def _cell(task: TaskConfig, agent: str, maps: range, split: str) -> Cell:
    try:
        return episodes_key(task, agent, maps, split)
    except (TooLargeError, UnsupportedTaskError) as error:
        return error
    except CheckpointError as error:
        if network_file(agent) is None:
            raise  # a file of the package is damaged
        return error


def _check_that_some_fly(cells: dict[TaskConfig, dict[str, Cell]]) -> None:
    """Somebody must fly something, and a network's file that is named must fit a task: else raise the first reason."""
    agents = [*next(iter(cells.values()))]
    for judged in (agents, *([agent] for agent in agents if network_file(agent))):
        all_cells = [row[agent] for row in cells.values() for agent in judged]
        reasons = [cell for cell in all_cells if not isinstance(cell, EpisodesKey)]
        if len(reasons) == len(all_cells):
            raise reasons[0]


def _by_checkpoint(agents: tuple[str, ...], file: Path) -> tuple[str, ...]:
    """The agents, those that can fly by the network in a file by that one."""
    if not set(agents) & set(NETWORK_AGENTS):
        raise InvalidValueError(f"--checkpoint is the network of an agent: name it with --agents {CHOICE}")
    network = network_of(file)
    fits = [name for name, agent in NETWORK_AGENTS.items() if agent.network == network]
    if not set(agents) & set(fits):
        raise InvalidValueError(f"{file} is the network of {'|'.join(fits) or network}: name it with --agents")
    return tuple(f"{agent}:{file}" if agent in fits else agent for agent in agents)


@contextlib.contextmanager
def _engine(name: str, address: str | None) -> Generator[Engine, None, None]:
    if name == "local":
        yield local_engine
        return
    from drone_env.cluster.connect import connect

    with connect(address):
        from drone_env.cluster.episodes import fly_on_nodes

        yield fly_on_nodes


def _fly_all(
    keys: list[EpisodesKey], engine: Engine, folder: ResultsFolder | None
) -> dict[EpisodesKey, EpisodeResults]:
    with progress_bar("maps", sum(key.seeds[1] - key.seeds[0] for key in keys)) as advance:

        def arrived(piece: EpisodeResults) -> None:
            advance(len(piece.seeds), f"{get_task(piece.key.task).short_name} {piece.key.agent}")

        return evaluate_keys(keys, engine, folder, arrived)


def _print(report: dict[str, Any]) -> None:
    head = ("task", "agent", "score (95 %)", "optimum", "ratio", "regret", "success", "steps", "excess")
    rows = [
        (
            f"{get_task(task_id).short_name} v{of_task['version']}",
            agent,
            with_margin(figures["mean_score"], figures["score_ci95"]),
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
    table = Table("Graded score beside the exact optimum of the same maps", head, rows)
    print_table(table, width=120, names=2, caption=caption, sections=True)
    for task_id, of_task in report["tasks"].items():
        for agent, figures in of_task["agents"].items():
            if "unsupported" in figures:
                print(f"{get_task(task_id).short_name}, {agent}: {figures['unsupported']}")
