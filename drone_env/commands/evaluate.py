"""`drone-env evaluate`: agents side by side on the same maps, beside the exact optimum."""

import contextlib
import json as json_format
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from drone_env import __version__
from drone_env.agents import AGENTS
from drone_env.commands.arguments import SHORT_NAMES, ClusterAddress, SeedRange, SplitName, chosen_maps
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import InvalidValueError
from drone_env.evaluation.episodes import EpisodeResults, EpisodesKey, episodes_key, summarise
from drone_env.evaluation.folder import Engine, ResultsFolder, evaluate_keys, local_engine
from drone_env.files import replacing

TaskNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar=f"all|{'|'.join(SHORT_NAMES)}")]
AgentNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar="|".join(AGENTS))]
JsonFile = Annotated[str | None, tyro.conf.arg(metavar="FILE|-")]


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
    what of it to quote.

    Example: drone-env evaluate --task hard --agents greedy optimal --episodes 100 --json results.json

    Args:
        task: One or more tasks, or all.
        agents: One or more agents.
        split: Whose first maps to fly: test if nothing is said. Training never touches validation and test.
        episodes: How many maps of the split, 1000 if nothing is said.
        seeds: Fly the maps from A up to and not including B instead of a split's.
        checkpoint: Fly `pathqnet` by the network in this file (.npz) instead of the shipped one.
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
        if "pathqnet" not in agents:
            raise InvalidValueError("--checkpoint is the network of the agent pathqnet: name it with --agents")
        agents = tuple(f"pathqnet:{checkpoint}" if agent == "pathqnet" else agent for agent in agents)
    target = None if json in (None, "-") else Path(json)
    if target is not None and (not target.name or target.is_dir() or not target.parent.is_dir()):
        raise InvalidValueError(f"--json takes - or a file in a folder that exists, got {json!r}")
    named = [t for name in task for t in (TASKS.values() if name == "all" else [get_task(name)])]
    keys = {t: {agent: episodes_key(t, agent, maps, chosen_split) for agent in agents} for t in dict.fromkeys(named)}

    if address is not None and engine != "ray":
        raise InvalidValueError("--address names a cluster: give it with --engine ray")
    all_keys = [key for of_agent in keys.values() for key in of_agent.values()]
    folder = None if out is None else ResultsFolder(out, all_keys)
    try:
        with _engine(engine, address) as chosen_engine:
            results = _fly_all(all_keys, chosen_engine, folder)
    except KeyboardInterrupt:
        if out is not None:
            print(f"interrupted; to go on, give the same options with --out {out}", file=sys.stderr)
        raise
    figures = {t.id: _report_task(t, of_agent, results) for t, of_agent in keys.items()}
    report = {"package": __version__, "tasks": figures}
    text = json_format.dumps(report, indent=2) + "\n"
    if json == "-":
        sys.stdout.write(text)
        return
    if target is not None:
        with replacing(target) as temporary:
            temporary.write_text(text, encoding="utf-8")
    Console(width=None if sys.stdout.isatty() else 120).print(_table(report))


@contextlib.contextmanager
def _engine(name: str, address: str | None) -> Generator[Engine, None, None]:
    if name == "local":
        yield local_engine
        return
    from drone_env.cluster.connect import LOCAL, connect

    with connect(LOCAL if address is None else address):
        from drone_env.cluster.episodes import fly_on_nodes

        yield fly_on_nodes


def _fly_all(
    keys: list[EpisodesKey], engine: Engine, folder: ResultsFolder | None
) -> dict[EpisodesKey, EpisodeResults]:
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        bar = progress.add_task("maps", total=sum(key.seeds[1] - key.seeds[0] for key in keys))

        def arrived(piece: EpisodeResults) -> None:
            name = f"{get_task(piece.key.task).short_name} {piece.key.agent}"
            progress.update(bar, advance=len(piece.seeds), description=name)

        return evaluate_keys(keys, engine, folder, arrived)


def _report_task(
    task: TaskConfig, keys: dict[str, EpisodesKey], results: dict[EpisodesKey, EpisodeResults]
) -> dict[str, Any]:
    key = next(iter(keys.values()))
    start, stop = key.seeds
    return {
        "version": task.version,
        "split": key.split,
        "seeds": [start, stop],
        "episodes": stop - start,
        "agents": {agent: summarise(results[agent_key]) for agent, agent_key in keys.items()},
    }


def _table(report: dict[str, Any]) -> Table:
    table = Table(
        title="Graded score beside the exact optimum of the same maps",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    table.add_column("task", no_wrap=True)
    table.add_column("agent", no_wrap=True)
    for heading in ("score (95 %)", "optimum", "ratio", "regret", "success", "steps", "excess"):
        table.add_column(heading, justify="right", no_wrap=True)
    for task_id, of_task in report["tasks"].items():
        table.add_section()
        for agent, figures in of_task["agents"].items():
            interval = figures["score_ci95"]
            half_width = "" if interval is None else f" ± {interval[1] - figures['mean_score']:.4f}"
            table.add_row(
                f"{get_task(task_id).short_name} v{of_task['version']}",
                agent,
                f"{figures['mean_score']:.4f}{half_width}",
                _figure(figures["mean_optimal_score"], ".4f"),
                _figure(figures["score_ratio"], ".4f"),
                _figure(figures["mean_regret"], ".4f"),
                f"{figures['success_rate']:.1%}",
                f"{figures['mean_steps']:.1f}",
                _figure(figures["mean_excess_steps"], ".2f"),
            )
    flown = next(iter(report["tasks"].values()))
    start, stop = flown["seeds"]
    table.caption = f"{stop - start:,} maps a task, split {flown['split']}, seeds {start} to {stop - 1}"
    return table


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
