"""`drone-env compare`: agents on the same maps, and how sure it is which of them is better."""

from pathlib import Path
from typing import Annotated, Any

import tyro

from drone_env import __version__
from drone_env.commands.arguments import AGENT, SeedRange, SplitName, chosen_maps
from drone_env.commands.evaluate import JsonFile, TaskNames, fly_grid, json_file, write_report
from drone_env.commands.leaderboard import required_entries
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError
from drone_env.results.result import Results
from drone_env.results.statistics import compared, with_interval
from drone_env.results.tables import Table, percent, print_table

Contenders = Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar=f"{AGENT}|DIR...")]


def compare(
    agents: Contenders,
    task: TaskNames = ("all",),
    split: SplitName = None,
    episodes: int | None = None,
    seeds: SeedRange = None,
    repeats: int = 1,
    json: JsonFile = None,
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
    """
    stored = {
        agent: [(f"{entry.agent} ({Path(agent)})", entry) for entry in required_entries(Path(agent))]
        for agent in agents
        if Path(agent).is_dir()
    }
    contenders = len(agents) - len(stored) + sum(len({name for name, _ in entries}) for entries in stored.values())
    if contenders < 2 or len(set(agents)) < len(agents):
        raise InvalidValueError(f"compare takes two agents or more, each once; got {' '.join(agents) or 'none'}")
    if stored:
        if task != ("all",) or (split, episodes, seeds) != (None, None, None):
            raise InvalidValueError("folders name task and maps themselves: leave --task, --split and so on out")
        task, chosen_split, maps = _same_maps([(name, entry.results) for of in stored.values() for name, entry in of])
    else:
        chosen_split, maps = chosen_maps(seeds, split, episodes, 200)
    json_file(json)
    names = [agent for agent in agents if agent not in stored]
    flown = fly_grid(task, names, maps, chosen_split, repeats) if names else {}
    rows: dict[TaskConfig, dict[str, Results]] = {}
    unusable: dict[str, Any] = {}
    for agent in agents:
        for name, entry in stored.get(agent, ()):
            key = entry.results.key
            rows.setdefault(get_task(key.task, key.version), {})[name] = entry.results
            if "unusable" in entry.report:
                unusable[name] = entry.report["unusable"]
        for t, row in flown.items():
            cell = row.get(agent)
            if isinstance(cell, Results):
                rows.setdefault(t, {})[agent] = cell
    report = {
        "package": __version__,
        "split": chosen_split,
        "seeds": [maps.start, maps.stop],
        "repeats": repeats,
        "tasks": {t.id: {"version": t.version, **compared(row)} for t, row in rows.items()},
        "unusable": unusable,
    }
    if write_report(report, json):
        _print(report)
        for t, row in flown.items():
            for agent, cell in row.items():
                if not isinstance(cell, Results):
                    print(f"{t.short_name}, {agent}: {cell}")


def _same_maps(stored: list[tuple[str, Results]]) -> tuple[tuple[str, ...], str, range]:
    """The tasks, the split and the maps of all folders."""
    first, one = stored[0]
    maps = range(*one.key.seeds)
    for name, other in stored:
        key = other.key
        same = (key.split, key.seeds) == (one.key.split, one.key.seeds)
        if not same or get_task(key.task) != get_task(key.task, key.version):
            raise InvalidValueError(
                f"folders are compared over the same maps of the present version of a task: {name} has "
                f"{key.task} v{key.version}, {range(*key.seeds)}, {first} {maps}"
            )
    return tuple(dict.fromkeys(other.key.task for _, other in stored)), one.key.split, maps


def _print(report: dict[str, Any]) -> None:
    tasks = {f"{get_task(name).short_name} v{of['version']}": of for name, of in report["tasks"].items()}
    one = [
        (task, agent, _format(figures["score"]), _format(figures["iqm"]), percent(figures["success_rate"]))
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
            _format(figures["difference"]),
            _format(figures["improvement"], ".1%"),
            f"{figures['detectable']:.4f}",
            "-" if figures["narrower"] is None else f"{figures['narrower']:.1f}",
        )
        for task, of in tasks.items()
        for agent, figures in of["others"].items()
    ]
    head = ("task", "who", "difference (95 %)", "better (95 %)", "detectable", "narrower")
    if two:
        print_table(Table("Map by map", head, two), width=120, names=2, sections=True)


def _format(interval: dict[str, float], form: str = ".4f") -> str:
    return with_interval(interval["mean"], (interval["low"], interval["high"]), form)
