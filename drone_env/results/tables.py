"""Tables of figures, each made once and shown as HTML, as Markdown or on the terminal."""

import sys
from collections.abc import Collection, Sequence
from typing import NamedTuple

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable


class Table(NamedTuple):
    """One table: its title, its headings (none where each row is a name and a value), its rows."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def number(value: float | None, form: str = ".4f") -> str:
    """A figure, with four decimals if nothing is said; `-` where it is not known."""
    return "-" if value is None else format(value, form)


def percent(value: float | None) -> str:
    """A share in percent; `-` where it is not known."""
    return number(value, ".1%")


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown; the cells stand in it as they are."""
    lines = ["|" + "".join(f" {cell} |" if cell else " |" for cell in row) for row in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])


def table_console(width: int) -> Console:
    """Standard output, this many columns wide where it is no terminal."""
    return Console(width=None if sys.stdout.isatty() else width, highlight=False)


def print_table(
    table: Table,
    width: int,
    names: int,
    caption: str | None = None,
    sections: bool = False,
    alarming: Collection[int] = (),
) -> None:
    """Print a table on standard output.

    Args:
        table: The table.
        width: Columns of the page where standard output is no terminal.
        names: How many of the first columns are names; the others are figures and stand to the right.
        caption: A line below.
        sections: Whether rows with another first cell than the one above stand apart.
        alarming: Numbers of rows to show in red, from 0.
    """
    shown = RichTable(
        title=escape(table.title), caption=caption, box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True
    )
    for i, heading in enumerate(table.head):
        shown.add_column(heading, justify="left" if i < names else "right", no_wrap=i >= names)
    for i, (row, following) in enumerate(zip(table.rows, [*table.rows[1:], ("",)], strict=True)):
        end = sections and row[0] != following[0]
        shown.add_row(*map(escape, row), end_section=end, style="red" if i in alarming else None)
    table_console(width).print(shown)
