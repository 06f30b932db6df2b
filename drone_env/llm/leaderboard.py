"""Runs side by side: only those that were checked, are whole, and flew the same maps are ranked against each other."""

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from drone_env.errors import DroneEnvError, WithdrawnError
from drone_env.llm.report import report
from drone_env.llm.run_folder import RESULTS, load_config
from drone_env.llm.verify import verified_run


class Refused(NamedTuple):
    """A run that is not ranked."""

    path: Path
    reason: str
    damaged: bool
    """Whether it is not what it says; else it is only not whole, or invalid, or of what is withdrawn."""


class Judged(NamedTuple):
    """A run that is ranked."""

    path: Path
    figures: dict[str, Any]
    """Those of its report."""


class Board(NamedTuple):
    """Runs over the same maps of the same task, best first, by (score - random) / (optimal - random), then by score."""

    task: str
    maps: str
    rows: list[dict[str, Any]]


def leaderboard(paths: Iterable[Path]) -> tuple[list[Board], list[Refused]]:
    """Check runs and rank them.

    Args:
        paths: The run folders; one that is named twice counts once.
    """
    judged = [judge(path) for path in {path.resolve(): path for path in paths}.values()]
    ranked = [one for one in judged if isinstance(one, Judged)]
    return boards_of(ranked), [one for one in judged if isinstance(one, Refused)]


def judge(path: Path) -> Judged | Refused:
    """Check a run: its figures, or why it is not ranked."""
    try:
        load_config(path)
        if not (path / RESULTS).exists():
            # Written at the end of each part of a run.
            under_way = "no flights yet: it is under way, or was killed and can be gone on with (--resume)"
            return Refused(path, under_way, damaged=False)
        run = verified_run(path)
    except WithdrawnError as error:
        return Refused(path, str(error), damaged=False)
    except (DroneEnvError, OSError, ValueError) as error:
        return Refused(path, str(error).removeprefix(f"{path}: "), damaged=True)
    figures = report(run, moves=False)
    if figures["verdict"] != "valid":
        return Refused(path, f"{figures['verdict']}: {figures['reason']}", damaged=False)
    return Judged(path, figures)


def boards_of(judged: Iterable[Judged]) -> list[Board]:
    """Runs that are ranked, on the board of their maps."""
    boards: dict[tuple[str, str], list[dict[str, Any]]] = defaultdict(list)
    for path, figures in judged:
        config = figures["config"]
        task = f"{config['task']} version {config['task_version']}"
        maps = f"maps {config['seeds'][0]} to {config['seeds'][1] - 1} ({config['split']})"
        boards[task, maps].append({"path": str(path), **figures})
    return [Board(*key, sorted(rows, key=_merit, reverse=True)) for key, rows in sorted(boards.items())]


def _merit(row: dict[str, Any]) -> tuple[float, float]:
    return float("-inf") if row["normalised"] is None else row["normalised"], row["score"]
