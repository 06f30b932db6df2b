"""How several subcommands print: JSON, progress bars, commands to type."""

import json
import shutil
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


def program(name: str) -> str:
    """What to type for a program of this environment: its name if the shell finds it, else its path."""
    here, found = Path(sys.executable).with_name(name), shutil.which(name)
    if found is not None and Path(found).parent == here.parent:
        return name
    return str(here.relative_to(Path.cwd()) if here.is_relative_to(Path.cwd()) else here)


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
