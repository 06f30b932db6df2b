"""How several subcommands print: JSON, progress bars, commands to type."""

import json
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from textwrap import wrap
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from drone_env.errors import UnknownNameError

WIDTH = 80
"""Columns of a terminal, if nothing else is known."""


def print_error(error: object) -> None:
    """An error on standard error, in two lines of 80 columns where its message allows that.

    Of a long list of names that are allowed, as many are printed as fit.
    """
    text = f"drone-env: {error}"
    if isinstance(error, UnknownNameError):
        text += ", CITY.toml" if error.kind == "task" else ""  # which commands take, and calls do not
        start, _, names = text.partition("allowed: ")
        shown = names.split(", ")
        while len(wrap(text, WIDTH)) > 2 and len(shown) > 1:
            shown.pop()
            text = f"{start}allowed: {', '.join(shown)} and {names.count(', ') + 1 - len(shown)} more"
    print(text, file=sys.stderr)


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
