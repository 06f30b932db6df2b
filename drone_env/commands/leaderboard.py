"""`drone-env leaderboard`: runs of language models side by side."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from drone_env.commands.printing import print_json
from drone_env.errors import InvalidValueError, needs
from drone_env.reports.tables import Table, number, percent, print_table, with_margin

if TYPE_CHECKING:
    from drone_env.llm.leaderboard import Board

Folders = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR...")]


def leaderboard(folders: Folders, json: bool = False) -> int:
    """Rank runs of `drone-env infer` over the same maps.

    Each run is flown again from the model's own answers first. A run whose flights do not come to what it says is
    refused, and so is one that is invalid or not whole. Exit status: 0, or 1 if a run does not come to what it says.

    Example: drone-env leaderboard data/llm/*

    Args:
        folders: The run folders, or folders of several runs.
        json: Print JSON instead of tables.
    """
    with needs("llm"):
        from drone_env.llm.leaderboard import leaderboard as rank

    if not folders:
        raise InvalidValueError("leaderboard takes the folders of one run or more")
    boards, refused = rank(folders)
    if json:
        report = {
            "boards": [board._asdict() for board in boards],
            "refused": [{"path": str(run.path), "reason": run.reason} for run in refused],
        }
        print_json(report)
    else:
        for board in boards:
            print_table(_table(board), width=140, names=3)
        for run in refused:
            print(f"not ranked: {run.path}: {run.reason}", file=sys.stderr)
    return int(any(run.damaged for run in refused))


def _table(board: "Board") -> Table:
    figures = ("score (95 %)", "normalised", "regret", "success", "errored", "WAIT in place", "tokens")
    rows = [
        (
            str(rank),
            row["config"]["model"],
            row["config"]["prompt"],
            with_margin(row["score"], row["score_ci95"]),
            number(row["normalised"]),
            number(row["regret"]),
            percent(row["success_rate"]),
            str(row["flights"]["errored"]),
            str(row["waits"]),
            str(sum(row["tokens"].values())),
        )
        for rank, row in enumerate(board.rows, 1)
    ]
    return Table(f"{board.task}, {board.maps}", ("", "model", "prompt", *figures), rows)
