"""`drone-env leaderboard`: runs of language models side by side."""

import json as json_format
import sys
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from drone_env.errors import InvalidValueError, needs

Folders = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR...")]


def leaderboard(folders: Folders, json: bool = False) -> int:
    """Rank runs of `drone-env infer` over the same maps.

    Each run is flown again from the model's own answers first. A run whose flights do not come to what it says is
    refused, and so is one that is invalid or not whole. Exit status: 0, or 1 if a run does not come to what it says.

    Example: drone-env leaderboard data/llm/*

    Args:
        folders: The run folders.
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
        print(json_format.dumps(report, indent=2, allow_nan=False))
    else:
        console = Console(width=None if sys.stdout.isatty() else 140)
        for board in boards:
            console.print(_table(f"{board.task}, {board.maps}", board.rows))
        for run in refused:
            print(f"not ranked: {run.path}: {run.reason}", file=sys.stderr)
    return int(any(run.damaged for run in refused))


def _table(title: str, rows: list[dict[str, Any]]) -> Table:
    table = Table(title=escape(title), box=box.SIMPLE_HEAD, pad_edge=False)
    for heading in ("", "model", "prompt"):
        table.add_column(heading)
    for heading in ("score (95 %)", "normalised", "regret", "success", "errored", "WAIT in place", "tokens"):
        table.add_column(heading, justify="right", no_wrap=True)
    for rank, row in enumerate(rows, 1):
        interval, tokens = row["score_ci95"], row["tokens"]
        table.add_row(
            str(rank),
            escape(row["config"]["model"]),
            row["config"]["prompt"],
            f"{row['score']:.4f}" + ("" if interval is None else f" ± {interval[1] - row['score']:.4f}"),
            "-" if row["normalised"] is None else f"{row['normalised']:.4f}",
            "-" if row["regret"] is None else f"{row['regret']:.4f}",
            f"{row['success_rate']:.1%}",
            str(row["flights"]["errored"]),
            str(row["waits"]),
            str(tokens["prompt"] + tokens["completion"]),
        )
    return table
