"""`drone-env leaderboard`: rank agents and language models."""

import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drone_env.commands.arguments import Folders
from drone_env.errors import InvalidValueError, needs
from drone_env.results.leaderboard import Leaderboard, LeaderboardEntry, NotRanked, evaluation_entries, group_by_maps
from drone_env.results.statistics import DIFFERENCES, PairedComparison, ci95, mean_of
from drone_env.results.tables import Table, known_sum, number, percent, print_table, with_interval

EVALUATION, RUN = "evaluation.json", "run.json"
"""Copies of constants: `results.folder` loads Pydantic, `llm.run_folder` needs an extra."""


def leaderboard(folders: Folders) -> int:
    """Rank agents and language models over the same maps: folders of `drone-env evaluate --out` and of `infer`.

    The answers of a language model are flown again. A run whose answers do not fit it is refused, and so are
    invalid and incomplete folders. Evaluations store no actions, so their scores are believed. "- first" is the mean
    score minus that of the first row, map by map. Exit status: 0, or 1 if a folder is not ranked.

    Example: drone-env leaderboard data/llm/* data/evaluations/*

    Args:
        folders: The folders.
    """
    if not folders:
        raise InvalidValueError("leaderboard takes the folders of one run or evaluation, or more")
    entries = [entry for folder in folders for entry in _entries(folder)]
    boards = group_by_maps(entry for entry in entries if isinstance(entry, LeaderboardEntry))
    refused = [entry for entry in entries if isinstance(entry, NotRanked)]
    for board in boards:
        marked = [i for i, entry in enumerate(board.rows) if entry.report.get("unusable", {}).get("marked")]
        caption = "! more than 5 % of the answers were unusable; the drone waited instead" if marked else None
        print_table(_table(board), names=3, caption=caption, alarming=marked)
    for run in refused:
        print(f"not ranked: {run.path}: {run.reason}", file=sys.stderr)
    return int(bool(refused))


def _entries(path: Path) -> list[LeaderboardEntry | NotRanked]:
    """Return the entries of an evaluation or of a run of a language model."""
    if (path / EVALUATION).exists():
        return evaluation_entries(path)
    if (path / RUN).exists():
        with needs("llm"):
            from drone_env.llm.report import run_entry
        return [run_entry(path)]
    reason = "no results in it" if path.is_dir() else "no such folder"
    return [NotRanked(path, f"{reason}; give a folder of evaluate --out or infer --out")]


def _table(board: Leaderboard) -> Table:
    figures = ("score (95 %)", "- first (95 %)", "normalised", "regret", "success", "errored", "unusable", "tokens")
    same = Counter((entry.agent, entry.prompt) for entry in board.rows)
    rows = [
        (
            str(rank),
            f"{entry.agent} ({entry.path.name})" if same[entry.agent, entry.prompt] > 1 else entry.agent,
            entry.prompt or "-",
            with_interval(entry.summary.score, entry.summary.score_ci95),
            _difference(entry, board.rows[0]),
            number(entry.normalised),
            number(entry.summary.regret),
            percent(entry.summary.success_rate),
            *_model_columns(entry.report),
        )
        for rank, entry in enumerate(board.rows, 1)
    ]
    return Table(f"{board.task}, {board.maps}", ("", "agent or model", "prompt", *figures), rows)


def _difference(entry: LeaderboardEntry, first: LeaderboardEntry) -> str:
    """Return the difference of the scores, map by map."""
    differences = PairedComparison.of(entry.results, first.results).differences
    return "" if entry is first else with_interval(mean_of(differences), ci95(differences, DIFFERENCES))


def _model_columns(report: Mapping[str, Any]) -> tuple[str, str, str]:
    """Return errored flights, unusable answers and tokens of a language model."""
    if not report:
        return "-", "-", "-"
    from drone_env.llm.answers import Unusable

    unusable = Unusable(report["unusable"]["answers"], report["unusable"]["of"])
    tokens = known_sum(report["tokens"]["total"], report["calls"]["without_usage"], "d")
    return str(report["flights"]["errored"]), str(unusable), tokens
