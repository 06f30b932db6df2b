"""`drone-env compare`: agents on the same maps, paired map by map."""

from pathlib import Path
from typing import Annotated, Any, NamedTuple

import tyro

from drone_env import __version__
from drone_env.commands.arguments import AGENT, SeedRange, SplitName, select_maps
from drone_env.commands.evaluate import JsonFile, TaskNames, fly_grid, json_file, write_report
from drone_env.commands.leaderboard import required_entries
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError
from drone_env.results.leaderboard import LeaderboardEntry
from drone_env.results.result import EpisodesKey, Results
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
    """Fly the same maps with two agents or more and compare their scores.

    All others are compared with the first, map by map. Difference: mean score minus that of the first. Better: share of
    maps with a higher score; ties count half. Intervals (95 %) are over maps (docs/quoting.md); the comparisons of a
    task hold together. IQM is the mean of the middle half of the maps. See docs/agents.md.

    Example: drone-env compare greedy optimal --task hard --episodes 200

    Args:
        agents: Two or more agents as in `evaluate --agents`, or folders of `evaluate --out` and of `infer`. The other
            agents fly the maps of the folders.
        task: One or more tasks; `all` for every registered task.
        split: Fly the first maps of this split. Default: test.
        episodes: Number of maps of the split. Default: 200.
        seeds: Fly maps A to B - 1 instead.
        repeats: Flights per map of stochastic agents; their mean counts.
        json: Write the statistics to this file; - prints only JSON to standard output.
    """
    contest = _chosen(agents, task, split, episodes, seeds)
    json_file(json)
    flown = fly_grid(contest.tasks, contest.names, contest.maps, contest.split, repeats) if contest.names else {}
    rows: dict[TaskConfig, dict[str, Results]] = {}
    for agent in agents:
        for name, entry in contest.stored.get(agent, ()):
            rows.setdefault(get_task(entry.results.key.task), {})[name] = entry.results
        for t, row in flown.items():
            if isinstance(cell := row.get(agent), Results):
                rows.setdefault(t, {})[agent] = cell
    report = {
        "package": __version__,
        "split": contest.split,
        "seeds": [contest.maps.start, contest.maps.stop],
        "repeats": repeats,
        "tasks": {t.id: {"version": t.version, **compared(row)} for t, row in rows.items()},
        "unusable": {
            name: entry.report["unusable"]
            for of_folder in contest.stored.values()
            for name, entry in of_folder
            if "unusable" in entry.report
        },
    }
    if json is not None:
        write_report(report, json)
    if json != "-":
        _print(report)
        for t, row in flown.items():
            for agent, cell in row.items():
                if not isinstance(cell, Results):
                    print(f"{t.short_name}, {agent}: {cell}")


class Contest(NamedTuple):
    """The comparison: entries of folders by the argument, agents to fly, and their maps."""

    stored: dict[str, list[tuple[str, LeaderboardEntry]]]
    names: list[str]
    tasks: tuple[str, ...]
    split: str
    maps: range


def _chosen(
    agents: tuple[str, ...], task: tuple[str, ...], split: str | None, episodes: int | None, seeds: str | None
) -> Contest:
    """Read the folders and choose the maps."""
    stored = {
        agent: [(f"{entry.agent} ({Path(agent)})", entry) for entry in required_entries(Path(agent))]
        for agent in agents
        if Path(agent).is_dir()
    }
    entries = [named for of_folder in stored.values() for named in of_folder]
    names = [agent for agent in agents if agent not in stored]
    if len({*names, *(name for name, _ in entries)}) < 2 or len(set(agents)) < len(agents):
        raise InvalidValueError(f"compare takes two agents or more, each once; got {' '.join(agents) or 'none'}")
    if not stored:
        return Contest(stored, names, task, *select_maps(seeds, split, episodes, 200))
    if task != ("all",) or (split, episodes, seeds) != (None, None, None):
        raise InvalidValueError("folders name task and maps themselves: leave --task, --split and so on out")
    return Contest(stored, names, *_same_maps([(name, entry.results.key) for name, entry in entries]))


def _same_maps(keys: list[tuple[str, EpisodesKey]]) -> tuple[tuple[str, ...], str, range]:
    """Return tasks, split and maps of all folders."""
    first, one = keys[0]
    maps = range(*one.seeds)
    for name, key in keys:
        same = (key.split, key.seeds) == (one.split, one.seeds)
        if not same or get_task(key.task) != get_task(key.task, key.version):
            start, stop = key.seeds
            raise InvalidValueError(
                f"folders are compared over the same maps of the present version: {name} has "
                f"{key.task} v{key.version}, maps {start}:{stop}; {first} has maps {maps.start}:{maps.stop}"
            )
    return tuple(dict.fromkeys(key.task for _, key in keys)), one.split, maps


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
    print_table(Table("Graded score", head, one), names=2, caption=caption, sections=True)
    for name, unusable in report["unusable"].items():
        from drone_env.llm.answers import Unusable

        print(f"{name}: unusable answers {Unusable(unusable['answers'], unusable['of'])}")
    two = [
        (task, f"{agent} - {of['first']}", _format(figures["difference"]), _format(figures["improvement"], ".1%"))
        for task, of in tasks.items()
        for agent, figures in of["others"].items()
    ]
    head = ("task", "who", "difference (95 %)", "better (95 %)")
    several = any(len(of["others"]) > 1 for of in tasks.values())
    caption = "the comparisons of a task hold together with 95 % (Bonferroni)" if several else None
    if two:
        print_table(Table("Map by map", head, two), names=2, caption=caption, sections=True)


def _format(interval: dict[str, float], form: str = ".4f") -> str:
    return with_interval(interval["mean"], (interval["low"], interval["high"]), form)
