"""`drone-env compare`: agents on the same maps, and how sure it is which of them is better."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from drone_env import __version__
from drone_env.commands.arguments import AGENT, SeedRange, SplitName, chosen_maps
from drone_env.commands.contest import JsonFile, TaskNames, cells_of, fly_cells, give_json, json_file
from drone_env.commands.kept import Kept, kept
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError
from drone_env.results.interval import with_interval
from drone_env.results.tables import Table, percent, print_table

if TYPE_CHECKING:
    from drone_env.results.by_map import FlownMap

Contenders = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar=f"{AGENT}|DIR...")]
Plot = Annotated[Path | None, tyro.conf.arg(metavar="FILE.svg|FILE.png")]


def compare(
    agents: Contenders,
    task: TaskNames = ("all",),
    split: SplitName = None,
    episodes: int | None = None,
    seeds: SeedRange = None,
    repeats: int = 1,
    json: JsonFile = None,
    plot: Plot = None,
) -> None:
    """Fly the same maps with two agents or more, and say how sure it is which of them is better.

    All others are compared with the first, map by map. Difference: score of the other less that of the first. Better:
    share of maps on which the other scores more, where equal scores count half. Detectable: the smallest true
    difference that as many maps would show in four of five cases. Narrower: how many times wider the interval of the
    difference would be if each had flown maps of its own. Intervals (95 %) are Student's t over maps; IQM is the mean
    of the middle half of the maps. docs/agents.md says more.

    Example: drone-env compare greedy optimal --task hard --episodes 200

    Args:
        agents: Two agents or more, named as `evaluate --agents` takes them; or folders of `evaluate --out` and of
            `infer`, whose maps the others then fly.
        task: One or more tasks; `all` for every registered task.
        split: Whose first maps to fly: test if nothing is said.
        episodes: How many maps of the split, 200 if nothing is said.
        seeds: Fly the maps from A up to and not including B instead of a split's.
        repeats: How often an agent that draws lots flies each map; the mean counts.
        json: Write the figures to this file; - prints only the JSON on standard output.
        plot: Draw the performance profiles: of each agent, the share of maps on which it reaches more than a share of
            the optimum. Needs the extra `train`.
    """
    # These load Pydantic, which nobody should wait for who does not need it.
    from drone_env.results.comparison import flown_maps
    from drone_env.results.profiles import check_plot, draw_profiles
    from drone_env.results.reliable import compared, shares_of_optimum

    folders = {agent: kept(Path(agent)) for agent in agents if Path(agent).is_dir()}
    contenders = len(agents) - len(folders) + sum(len({one.name for one in of}) for of in folders.values())
    if contenders < 2 or len(set(agents)) < len(agents):
        raise InvalidValueError(f"compare takes two agents or more, each once; got {' '.join(agents) or 'none'}")
    if folders:
        if task != ("all",) or (split, episodes, seeds) != (None, None, None):
            raise InvalidValueError("folders name task and maps themselves: leave --task, --split and so on out")
        task, chosen_split, maps = _maps_of([one for of_folder in folders.values() for one in of_folder])
    else:
        chosen_split, maps = chosen_maps(seeds, split, episodes, 200)
    json_file(json)
    if plot is not None:
        check_plot(plot)
    names = [agent for agent in agents if agent not in folders]
    flown = fly_cells(cells_of(task, names, maps, chosen_split, repeats)) if names else {}
    rows: dict[TaskConfig, dict[str, list[FlownMap]]] = {}
    for agent in agents:
        for one in folders.get(agent, ()):
            rows.setdefault(one.task, {})[one.name] = [row._replace(agent=one.name) for row in one.rows]
        for t, row in flown.items():
            cell = row.get(agent)
            if isinstance(cell, tuple):
                rows.setdefault(t, {})[agent] = flown_maps(agent, cell)
    report = {
        "package": __version__,
        "split": chosen_split,
        "seeds": [maps.start, maps.stop],
        "repeats": repeats,
        "tasks": {t.id: {"version": t.version, **compared(row)} for t, row in rows.items()},
        "unusable": {one.name: one.unusable for of_folder in folders.values() for one in of_folder if one.unusable},
    }
    cannot = [
        f"{t.short_name}, {agent}: {cell}"
        for t, row in flown.items()
        for agent, cell in row.items()
        if not isinstance(cell, tuple)
    ]
    if plot is not None:
        draw_profiles(
            {t.short_name: {a: shares_of_optimum(of) for a, of in row.items()} for t, row in rows.items()}, plot
        )
    if give_json(report, json):
        _print(report)
        print(*cannot, sep="\n", end="\n" if cannot else "")


def _maps_of(results: list[Kept]) -> tuple[tuple[str, ...], str, range]:
    """The tasks, the split and the maps that all folders are of."""
    first = results[0]
    for other in results:
        if (other.split, other.maps) != (first.split, first.maps) or get_task(other.task.id) != other.task:
            raise InvalidValueError(
                f"folders are compared over the same maps of the present version of a task: {other.name} has "
                f"{other.task.id} v{other.task.version}, {other.maps}, {first.name} {first.maps}"
            )
    return tuple(dict.fromkeys(one.task.id for one in results)), first.split, first.maps


def _print(report: dict[str, Any]) -> None:
    tasks = {f"{get_task(name).short_name} v{of['version']}": of for name, of in report["tasks"].items()}
    one = [
        (task, agent, _told(figures["score"]), _told(figures["iqm"]), percent(figures["success_rate"]))
        for task, of in tasks.items()
        for agent, figures in of["agents"].items()
    ]
    start, stop = report["seeds"]
    caption = f"{stop - start:,} maps a task, split {report['split']}, seeds {start} to {stop - 1}"
    head = ("task", "agent", "score (95 %)", "IQM (95 %)", "success")
    print_table(Table("Graded score", head, one), width=120, names=2, caption=caption, sections=True)
    for name, unusable in report["unusable"].items():
        from drone_env.llm.answers import Unusable

        print(f"{name}: unusable answers {Unusable(unusable['answers'], unusable['of'])}")
    two = [
        (
            task,
            f"{agent} - {of['first']}",
            _told(figures["difference"]),
            _told(figures["improvement"], ".1%"),
            f"{figures['detectable']:.4f}",
            "-" if figures["narrower"] is None else f"{figures['narrower']:.1f}",
        )
        for task, of in tasks.items()
        for agent, figures in of["others"].items()
    ]
    head = ("task", "who", "difference (95 %)", "better (95 %)", "detectable", "narrower")
    if two:
        print_table(Table("Map by map", head, two), width=120, names=2, sections=True)


def _told(interval: dict[str, float], form: str = ".4f") -> str:
    return with_interval(interval["mean"], (interval["low"], interval["high"]), form)
