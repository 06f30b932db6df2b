"""Leaderboards of agents and language models over the same maps of a task."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from drone_env.errors import DroneEnvError
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.result import Results, repeated
from drone_env.results.statistics import Summary, normalised


class NotRanked(NamedTuple):
    """A folder that is not ranked."""

    path: Path
    reason: str


@dataclass(frozen=True)
class LeaderboardEntry:
    """An agent on one task of an evaluation, or a run of a language model.

    Attributes:
        path: The folder.
        results: The flights that count.
        random: The mean score of random flights over the same maps; None if no flight counts.
        report: The report of a run, empty for an agent.
    """

    path: Path
    results: Results
    random: float | None
    report: Mapping[str, Any]

    @property
    def agent(self) -> str:
        """The agent or the model."""
        return self.results.key.agent

    @property
    def prompt(self) -> str | None:
        """The prompt of a run; None for an agent."""
        return self.report["config"]["prompt"] if self.report else None

    @cached_property
    def summary(self) -> Summary:
        """The statistics of the flights."""
        return Summary.of(self.results)

    @property
    def normalised(self) -> float | None:
        """(score - random) / (optimal - random)."""
        return normalised(self.summary.score, self.random, self.summary.optimum)


class Leaderboard(NamedTuple):
    """Entries over the same maps of a task, best first: by (score - random) / (optimal - random), then score."""

    task: str
    maps: str
    rows: list[LeaderboardEntry]


def evaluation_entries(
    path: Path, task: str | None = None, most: int | None = None
) -> list[LeaderboardEntry | NotRanked]:
    """Return the entries of an evaluation's folder, or why it is not ranked.

    Args:
        path: The folder.
        task: Read only this task; None for all.
        most: Maximum number of maps.
    """
    from drone_env.results.folder import stored_results  # loads Pydantic

    try:
        return [_entry(path, agent, repeats) for agent, repeats in stored_results(path, task, most)]
    except (DroneEnvError, OSError) as error:
        return [NotRanked(path, str(error))]


def _entry(path: Path, agent: str, repeats: tuple[Results, ...]) -> LeaderboardEntry:
    from drone_env.results.folder import shipped_results  # loads Pydantic

    key = repeats[0].key
    by_chance = episodes_key(key.task, "random", range(*key.seeds), key.split)
    random = shipped_results(by_chance) or run_episodes(by_chance)
    return LeaderboardEntry(path, repeated(repeats), fmean(random.scores), {})


def group_by_maps(entries: Iterable[LeaderboardEntry]) -> list[Leaderboard]:
    """Return one leaderboard for each set of maps."""
    boards: dict[tuple[str, str], list[LeaderboardEntry]] = defaultdict(list)
    for entry in entries:
        key = entry.results.key
        maps = f"maps {key.seeds[0]} to {key.seeds[1] - 1} ({key.split})"
        boards[f"{key.task} version {key.version}", maps].append(entry)
    return [Leaderboard(*key, sorted(rows, key=_rank, reverse=True)) for key, rows in sorted(boards.items())]


def _rank(entry: LeaderboardEntry) -> tuple[float, float]:
    normalised = entry.normalised
    return float("-inf") if normalised is None else normalised, entry.summary.score or 0.0
