"""Tables on the terminal, in Markdown and in LaTeX."""

import re
import sys
from collections.abc import Collection, Sequence
from typing import NamedTuple

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table as RichTable

UNLIMITED = 100_000
"""Columns of the page if standard output is not a terminal."""


class Table(NamedTuple):
    """One table. It has no headings if each row is a name and a value."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


def number(value: float | None, form: str = ".4f") -> str:
    """Format a number; `-` if it is unknown."""
    return "-" if value is None else format(value, form)


def plural(count: int, noun: str) -> str:
    """Format a count and what it counts."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def with_interval(mean: float | None, interval: Sequence[float] | None, form: str = ".4f") -> str:
    """Format a mean with both ends of its interval."""
    if mean is None or interval is None:
        return number(mean, form)
    low, high = interval
    return f"{mean:{form}} [{low:{form}}, {high:{form}}]"


def known_sum(value: float | None, missing: int, form: str) -> str:
    """Format a sum of which some terms are missing; `-` if all are."""
    return f"at least {value:{form}}" if missing and value is not None else number(value, form)


def percent(value: float | None) -> str:
    """Format a share in percent; `-` if it is unknown."""
    return number(value, ".1%")


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """Format rows as a table in Markdown; the first one is its head."""
    texts = [[cell.replace("|", r"\|") for cell in row] for row in rows]
    lines = ["|" + "".join(f" {cell} |" if cell else " |" for cell in row) for row in texts]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]])


def latex(rows: Sequence[Sequence[str]]) -> str:
    """Format rows as a table in LaTeX, which needs the package `booktabs`; the first one is its head."""
    lines = [" & ".join(re.sub(r"([&%$#_{}])", r"\\\1", cell) for cell in row) + r" \\" for row in rows]
    begin = rf"\begin{{tabular}}{{{'l' * len(rows[0])}}}"
    return "\n".join([begin, r"\toprule", lines[0], r"\midrule", *lines[1:], r"\bottomrule", r"\end{tabular}"])


def print_table(
    table: Table,
    names: int,
    caption: str | None = None,
    sections: bool = False,
    alarming: Collection[int] = (),
) -> None:
    """Print a table on standard output. On a narrow terminal, long cells continue on the next line.

    Args:
        table: The table.
        names: The first `names` columns are left-aligned; the others are numbers.
        caption: A line below the table.
        sections: Whether a new value in the first column starts a section.
        alarming: Indices of rows to show in red.
    """
    shown = RichTable(
        title=escape(table.title), caption=caption, box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True
    )
    for i, heading in enumerate(table.head):
        shown.add_column(heading, justify="left" if i < names else "right", overflow="fold", no_wrap=i == 0)
    for i, (row, following) in enumerate(zip(table.rows, [*table.rows[1:], ("",)], strict=True)):
        end = sections and row[0] != following[0]
        shown.add_row(*map(escape, row), end_section=end, style="red" if i in alarming else None)
    Console(width=None if sys.stdout.isatty() else UNLIMITED, highlight=False).print(shown)
