"""`drone-env leaderboard`: agents and language models side by side."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import tyro

from drone_env.commands.printing import print_json
from drone_env.errors import InvalidValueError, needs
from drone_env.results.leaderboard import Board, LeaderboardEntry, NotRanked, boards_of, evaluation_entries
from drone_env.results.statistics import with_interval
from drone_env.results.tables import Table, number, percent, print_table

Folders = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR...")]
EVALUATION, RUN = "evaluation.json", "run.json"
"""The first file of an evaluation and of a run: `results.folder` loads Pydantic, `llm.run_folder` needs an extra."""


def leaderboard(folders: Folders, json: bool = False) -> int:
    """Rank agents and language models over the same maps: folders of `drone-env evaluate --out` and of `infer`.

    A run of a language model is flown again from the model's own answers first. One whose flights do not come to what
    it says is refused, and so is what is invalid or not whole. Of an agent no actions are kept: its scores are held to
    the optima of their maps. Exit status: 0, or 1 if a folder is not what it says.

    Example: drone-env leaderboard data/llm/* data/evaluations/*

    Args:
        folders: The folders, or those that several runs lie in; one that is named twice counts once.
        json: Print JSON instead of tables.
    """
    if not folders:
        raise InvalidValueError("leaderboard takes the folders of one run or evaluation, or more")
    found = _entries_once(folders)
    boards = boards_of(one for one in found if isinstance(one, LeaderboardEntry))
    refused = [one for one in found if isinstance(one, NotRanked)]
    if json:
        rows = [
            board._asdict() | {"rows": [{"path": str(one.path), **one.report} for one in board.rows]}
            for board in boards
        ]
        print_json({"boards": rows, "refused": [{"path": str(run.path), "reason": run.reason} for run in refused]})
    else:
        for board in boards:
            marked = [i for i, one in enumerate(board.rows) if one.report.get("unusable", {}).get("marked")]
            caption = "! more than 5 % of the answers were unusable; the drone waited instead" if marked else None
            print_table(_table(board), width=140, names=3, caption=caption, alarming=marked)
        for run in refused:
            print(f"not ranked: {run.path}: {run.reason}", file=sys.stderr)
    return int(any(run.damaged for run in refused))


def _entries(path: Path) -> list[LeaderboardEntry | NotRanked]:
    """The entries of an evaluation, of a run of a language model, or of a folder of these.

    Raises:
        MissingPackageError: if there is a run of a language model, and the extra `llm` is not installed.
    """
    if (path / EVALUATION).exists():
        return evaluation_entries(path)
    if (path / RUN).exists():
        with needs("llm"):
            from drone_env.llm.report import run_entry
        return [run_entry(path)]
    inside = sorted(file.parent for name in (EVALUATION, RUN) for file in path.glob(f"*/{name}"))
    if not inside:
        what = "no results in it" if path.is_dir() else "no such folder"
        return [NotRanked(path, f"{what}; give a folder of evaluate --out or infer --out", damaged=True)]
    return [one for folder in inside for one in _entries(folder)]


def _entries_once(paths: Iterable[Path]) -> list[LeaderboardEntry | NotRanked]:
    """The entries of many folders; one that is named twice, itself or by the folder around it, counts once."""
    found: list[LeaderboardEntry | NotRanked] = []
    for path in paths:
        known = {one.path.resolve() for one in found}
        found += [one for one in _entries(path) if one.path.resolve() not in known]
    return found


def required_entries(path: Path) -> list[LeaderboardEntry]:
    """The entries of a folder of results.

    Raises:
        InvalidValueError: if it is not ranked on a leaderboard; the message says why.
        MissingPackageError: if it needs the extra `llm`.
    """
    found = _entries(path)
    refused = [one for one in found if isinstance(one, NotRanked)]
    if refused:
        raise InvalidValueError(f"{path}: {refused[0].reason}")
    return [one for one in found if isinstance(one, LeaderboardEntry)]


def _table(board: Board) -> Table:
    figures = ("score (95 %)", "normalised", "regret", "success", "errored", "unusable", "tokens")
    rows = [
        (
            str(rank),
            entry.agent,
            entry.report["config"].get("prompt", "-"),
            with_interval(entry.report["score"], entry.report["score_ci95"]),
            number(entry.report["normalised"]),
            number(entry.report["regret"]),
            percent(entry.report["success_rate"]),
            *_of_a_model(entry.report),
        )
        for rank, entry in enumerate(board.rows, 1)
    ]
    return Table(f"{board.task}, {board.maps}", ("", "agent or model", "prompt", *figures), rows)


def _of_a_model(report: dict[str, Any]) -> tuple[str, str, str]:
    """Errored flights, unusable answers and tokens, which an agent does not have."""
    if "agent" in report:
        return "-", "-", "-"
    from drone_env.llm.report import unusable_of

    return str(report["flights"]["errored"]), str(unusable_of(report)), str(sum(report["tokens"].values()))
