"""How several subcommands print: JSON, progress bars."""

import json
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


def print_json(report: dict[str, Any]) -> None:
    """A report on standard output; a number that is none in JSON is a fault of ours."""
    print(json.dumps(report, indent=2, allow_nan=False))


@contextmanager
def progress_bar(name: str, total: int) -> Generator[Callable[..., None], None, None]:
    """A bar on standard error, if that is a terminal; what it yields takes `advance=1` and another `name`."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.file.isatty()) as progress:
        bar = progress.add_task(name, total=total)

        def advance(advance: int = 1, name: str | None = None) -> None:
            progress.update(bar, advance=advance, description=name)

        yield advance
