"""Print JSON and progress bars."""

import json
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


def print_json(report: dict[str, Any]) -> None:
    """Print a report as JSON on standard output."""
    print(json.dumps(report, indent=2, allow_nan=False))


@contextmanager
def progress_bar(name: str, total: int, done: int = 0) -> Generator[Callable[..., None], None, None]:
    """Show a bar on standard error if it is a terminal; yields `advance(n=1, name=None)`."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    # Averaged over minutes: episodes of a training end in bursts, and validations take time.
    hidden = not console.file.isatty()
    with Progress(*columns, console=console, transient=True, disable=hidden, speed_estimate_period=300) as progress:
        bar = progress.add_task(name, total=total, completed=done)

        def advance(advance: int = 1, name: str | None = None) -> None:
            progress.update(bar, advance=advance, description=name)

        yield advance
