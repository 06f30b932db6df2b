"""Leaderboards of agents and language models over the same maps of a task."""

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np

from drone_env.errors import DroneEnvError
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.results.result import Results, repeated
from drone_env.results.statistics import normalised


class NotRanked(NamedTuple):
    """A folder that is not ranked."""

    path: Path
    reason: str


class LeaderboardEntry(NamedTuple):
    """An agent on one task of an evaluation, or a run of a language model."""

    path: Path
    report: dict[str, Any]
    """JSON values; they include `config` (`task`, `task_version`, `seeds`, `split`), `score` and `normalised`."""
    results: Results
    """The flights that count."""

    @property
    def agent(self) -> str:
        """The agent or the model."""
        return self.results.key.agent


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
    figures, results = summarise(*repeats), repeated(repeats)
    report = {
        "agent": agent,
        "config": {
            "task": key.task,
            "task_version": key.version,
            "split": key.split,
            "seeds": list(key.seeds),
        },
        "score": figures["mean_score"],
        "score_ci95": figures["score_ci95"],
        "normalised": normalised(figures["mean_score"], fmean(random.scores), figures["mean_optimal_score"]),
        "regret": figures["mean_regret"],
        "success_rate": figures["success_rate"],
    }
    return LeaderboardEntry(path, report, results)


def map_rows(results: Results) -> list[dict[str, Any]]:
    """Return the flights over each map as JSON values, by number of the map."""
    order = np.argsort(results.seeds, kind="stable")
    seeds, first = np.unique(results.seeds[order], return_index=True)
    best = results.optimal_scores
    return [
        {
            "seed": seed,
            "scores": results.scores[rows].tolist(),
            "optimum": None if np.isnan(best[rows[0]]) else float(best[rows[0]]),
            "success": int(results.success[rows].sum()),
            "steps": results.steps[rows].tolist(),
        }
        for seed, rows in zip(seeds.tolist(), np.split(order, first[1:]), strict=False)
    ]


def group_by_maps(entries: Iterable[LeaderboardEntry]) -> list[Leaderboard]:
    """Return one leaderboard for each set of maps."""
    boards: dict[tuple[str, str], list[LeaderboardEntry]] = defaultdict(list)
    for entry in entries:
        config = entry.report["config"]
        task = f"{config['task']} version {config['task_version']}"
        maps = f"maps {config['seeds'][0]} to {config['seeds'][1] - 1} ({config['split']})"
        boards[task, maps].append(entry)
    return [Leaderboard(*key, sorted(rows, key=_rank, reverse=True)) for key, rows in sorted(boards.items())]


def _rank(entry: LeaderboardEntry) -> tuple[float, float]:
    normalised = entry.report["normalised"]
    return float("-inf") if normalised is None else normalised, entry.report["score"]
