"""`drone-env evaluate`: agents on the same maps, with the exact optimum."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from drone_env import __version__
from drone_env.agents import Agent, make_agent
from drone_env.commands.arguments import TASK, AgentNames, ChosenAgent, OptionalPath, SeedRange, Split, select_maps
from drone_env.commands.printing import print_json, progress_bar
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import CheckpointError, InvalidValueError, TooLargeError, UnsupportedTaskError
from drone_env.planning.optimal import require_solvable
from drone_env.results.evaluate import FIGURES, episodes_key, evaluate_keys, figures_of, local_engine, repeats_of
from drone_env.results.result import EpisodesKey, Results, repeated
from drone_env.results.statistics import PairedComparison, Summary
from drone_env.results.tables import Table, number, percent, plural, print_table, with_interval

TaskNames = Annotated[tuple[str, ...], tyro.conf.arg(metavar=f"all|{TASK}")]
Cluster = Annotated[str | None, tyro.conf.arg(metavar="local|auto|HOST:PORT", help_behavior_hint="(optional)")]
Row = tuple[TaskConfig, str]
"""A task and an agent."""


def evaluate(
    task: TaskNames = ("all",),
    agents: AgentNames = ("random", "nearest", "beam", "optimal"),
    split: Split = "test",
    episodes: int = 1000,
    seeds: SeedRange = None,
    against: ChosenAgent = None,
    repeats: int = 1,
    out: OptionalPath = None,
    json: bool = False,
    ray: Cluster = None,
) -> None:
    """Fly many maps with several agents and compare their scores with the exact optimum of the same maps.

    Prints a table; a progress bar goes to standard error. Score: graded, 0.01 to 0.99, with its 95 % interval
    over maps, each for itself. Ratio: mean score / mean optimal score. Regret: mean of optimum - score. Excess: steps
    beyond the optimal flight, on delivered maps; negative if the optimal flight spends steps on charging. See
    docs/quoting.md. If an agent cannot fly a task, its row contains dashes, and the reason follows the table.

    Example: drone-env evaluate --task hard --agents nearest beam --episodes 100 --against nearest

    Args:
        task: One or more tasks; `all` for every registered task.
        agents: One or more agents: names, `pathqnet:FILE` (or `ppo`, `tournet`) for a network, also `USER/NAME` of the
            Hub, `MODULE:NAME` for your own agent or a model of Stable-Baselines3 (docs/agents.md).
        split: Fly the first maps of this split. Training never uses validation and test.
        episodes: Number of maps of the split.
        seeds: Fly maps A to B - 1 instead of a split's.
        against: Compare all others with this agent, map by map, in a second table. Better: share of maps with a higher
            score; ties count half. The intervals of a task hold together.
        repeats: Flights per map of stochastic agents; their mean counts.
        out: Store the results of each 1,000 maps in this folder; the same command resumes from it.
        json: Print JSON instead.
        ray: Fly on a Ray cluster (extra `cluster`), with equal results: local starts one on this machine, auto joins
            the one that runs here, HOST:PORT joins another.
    """
    chosen_split, maps = select_maps(seeds, split, episodes, 1000)
    names = [*agents, *([] if against is None else [against])]
    if not task or not names:
        raise InvalidValueError("--task and --agents take one name or more")
    tasks = chosen_tasks(task)
    made: dict[tuple[str, str], Agent] = {}

    def keys_of(task: TaskConfig, name: str) -> tuple[EpisodesKey, ...] | Exception:
        try:
            if name == "optimal":
                require_solvable(task)
            agent = made[task.id, name] = make_agent(name, task)
            return repeats_of(episodes_key(task, name, maps, chosen_split, made=agent), repeats, agent)
        except (CheckpointError, TooLargeError, UnsupportedTaskError) as error:
            return error

    rows = {(t, name): keys_of(t, name) for t in tasks for name in names}
    keys = [key for of_row in rows.values() if isinstance(of_row, tuple) for key in of_row]
    if not keys:
        raise next(of_row for of_row in rows.values() if isinstance(of_row, Exception))
    flown = _fly(keys, made, out, ray)
    results, cells = dict[Row, Results](), dict[Row, Summary | str]()
    for row, of_row in rows.items():
        if isinstance(of_row, tuple):
            results[row] = repeated([flown[key] for key in of_row])
            cells[row] = Summary.of(results[row])
        else:
            cells[row] = str(of_row)
    differences = {} if against is None else _differences(results, against)
    if json:
        print_json(_report(cells, differences, maps, chosen_split, repeats))
        return
    caption = f"{plural(len(maps), 'map')} a task, split {chosen_split}, seeds {maps.start} to {maps.stop - 1}"
    if repeats > 1:
        caption += f", {repeats} flights of each stochastic agent per map"
    print_results(cells, caption)
    if differences:
        _print_differences(differences, f"Against {against}, map by map")


def chosen_tasks(names: TaskNames) -> list[TaskConfig]:
    """Return the tasks of `--task`."""
    return [task for name in names for task in (TASKS.values() if name == "all" else [get_task(name)])]


def _fly(
    keys: Sequence[EpisodesKey], agents: dict[tuple[str, str], Agent], out: Path | None, ray: str | None
) -> dict[EpisodesKey, Results]:
    folder = None
    if out is not None:
        from drone_env.results.folder import ResultsFolder  # loads Pydantic

        folder = ResultsFolder(out, keys)
    engine = partial(local_engine, agents=agents)
    if ray is not None:
        from drone_env.cluster.ray_engine import fly_on_nodes

        engine = partial(fly_on_nodes, address=ray)
    with progress_bar("maps", sum(key.seeds[1] - key.seeds[0] for key in keys)) as advance:

        def arrived(chunk: Results) -> None:
            advance(len(chunk.seeds), f"{chunk.key.task} {chunk.key.agent}")

        return evaluate_keys(keys, engine, folder, arrived)


def _differences(results: dict[Row, Results], against: str) -> dict[Row, dict[str, Any]]:
    """Compare each agent with one of them, map by map."""
    pairs = {
        (task, name): PairedComparison.of(found, results[task, against])
        for (task, name), found in results.items()
        if name != against and (task, against) in results
    }
    together = {task: sum(other == task for other, _ in pairs) for task, _ in pairs}
    return {row: pair.figures(together[row[0]]) for row, pair in pairs.items()}


def _report(
    cells: dict[Row, Summary | str], differences: dict[Row, dict[str, Any]], maps: range, split: str, repeats: int
) -> dict[str, Any]:
    tasks: dict[str, Any] = {}
    for (task, agent), cell in cells.items():
        shared = {"split": split, "seeds": [maps.start, maps.stop], "episodes": len(maps), "repeats": repeats}
        agents = tasks.setdefault(task.id, {"version": task.version, **shared, "agents": {}})["agents"]
        if isinstance(cell, Summary):
            agents[agent] = figures_of(cell) | differences.get((task, agent), {})
        else:
            agents[agent] = {**dict.fromkeys(FIGURES), "unsupported": cell}
    return {"package": __version__, "tasks": tasks}


def print_results(cells: Mapping[Row, Summary | str], caption: str) -> None:
    """Print a row of figures for each task and agent, or why there are none."""
    head = ("task", "agent", "score (95 %)", "optimum", "ratio", "regret", "success", "steps", "excess")
    rows = [(f"{task.short_name} v{task.version}", agent, *_columns(cell)) for (task, agent), cell in cells.items()]
    print_table(Table("Graded score beside the exact optimum of the same maps", head, rows), 2, caption, sections=True)
    for (task, agent), cell in cells.items():
        if isinstance(cell, str):
            print(f"{task.short_name}, {agent}: {cell}")


def _print_differences(differences: dict[Row, dict[str, Any]], title: str) -> None:
    rows = [
        (f"{task.short_name} v{task.version}", agent, _interval(found["difference"]), _interval(found["better"], ".1%"))
        for (task, agent), found in differences.items()
    ]
    print_table(Table(title, ("task", "agent", "difference (95 %)", "better (95 %)"), rows), names=2, sections=True)


def _columns(summary: Summary | str) -> tuple[str, ...]:
    if isinstance(summary, str):
        return ("-",) * 7
    return (
        with_interval(summary.score, summary.score_ci95),
        number(summary.optimum),
        number(summary.ratio),
        number(summary.regret if summary.regret_maps == summary.maps else None),
        percent(summary.success_rate),
        number(summary.steps, ".1f"),
        number(summary.excess_steps, ".2f"),
    )


def _interval(figure: dict[str, float], form: str = ".4f") -> str:
    return with_interval(figure["mean"], (figure["low"], figure["high"]), form)
