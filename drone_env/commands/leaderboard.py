"""`drone-env leaderboard`: agents and language models side by side."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from drone_env.commands.kept import judged_once
from drone_env.commands.printing import print_json
from drone_env.errors import InvalidValueError
from drone_env.results.interval import with_interval
from drone_env.results.tables import Table, number, percent, print_table

if TYPE_CHECKING:
    from drone_env.results.leaderboard import Board

Folders = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR...")]


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
    from drone_env.results.leaderboard import Judged, Refused, boards_of

    if not folders:
        raise InvalidValueError("leaderboard takes the folders of one run or evaluation, or more")
    every = judged_once(folders)
    boards = boards_of(one for one in every if isinstance(one, Judged))
    refused = [one for one in every if isinstance(one, Refused)]
    if json:
        report = {
            "boards": [board._asdict() for board in boards],
            "refused": [{"path": str(run.path), "reason": run.reason} for run in refused],
        }
        print_json(report)
    else:
        for board in boards:
            marked = [i for i, row in enumerate(board.rows) if row.get("unusable", {}).get("marked")]
            caption = "! more than 5 % of the answers were unusable; the drone waited instead" if marked else None
            print_table(_table(board), width=140, names=3, caption=caption, alarming=marked)
        for run in refused:
            print(f"not ranked: {run.path}: {run.reason}", file=sys.stderr)
    return int(any(run.damaged for run in refused))


def _table(board: "Board") -> Table:
    figures = ("score (95 %)", "normalised", "regret", "success", "errored", "unusable", "tokens")
    rows = [
        (
            str(rank),
            *_who(row),
            with_interval(row["score"], row["score_ci95"]),
            number(row["normalised"]),
            number(row["regret"]),
            percent(row["success_rate"]),
            *_of_a_model(row),
        )
        for rank, row in enumerate(board.rows, 1)
    ]
    return Table(f"{board.task}, {board.maps}", ("", "agent or model", "prompt", *figures), rows)


def _who(row: dict[str, Any]) -> tuple[str, str]:
    return (row["agent"], "-") if "agent" in row else (row["config"]["model"], row["config"]["prompt"])


def _of_a_model(row: dict[str, Any]) -> tuple[str, str, str]:
    """Errored flights, unusable answers and tokens, which an agent does not have."""
    if "agent" in row:
        return "-", "-", "-"
    from drone_env.llm.report_tables import unusable_of

    return str(row["flights"]["errored"]), str(unusable_of(row)), str(sum(row["tokens"].values()))
