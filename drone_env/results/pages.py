"""Pages from the templates in this package. All values are escaped."""

import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from drone_env.files import write_json, write_text
from drone_env.results.tables import Table, markdown_table, number, percent

TEMPLATES = Path(__file__).with_name("templates")
ENTITIES = {letter: f"&#{ord(letter)};" for letter in "|`*\\"} | {"&": "&amp;", "<": "&lt;"}


def render(template: str, **values: Any) -> str:
    """Render a template in `templates/` as HTML or Markdown, by its suffix."""
    html, markdown = _environments()
    return (html if template.endswith(".html") else markdown).get_template(template).render(values)


def write_pages(folder: Path, figures: Mapping[str, Any], pages: Mapping[str, str]) -> None:
    """Write figures as `report.json`, and pages by file name. A partial file is never left.

    Raises:
        OSError: if they cannot be written.
    """
    write_json(folder / "report.json", figures)
    for name, text in pages.items():
        write_text(folder / name, text)


def as_markdown(text: object) -> str:
    """Escape a text for Markdown, in one line: names and errors may come from others."""
    if isinstance(text, Markup):
        return text
    line = re.sub(r"[&<|`*\\]", lambda found: ENTITIES[found[0]], " ".join(str(text).split()))
    # A link needs a second bracket.
    return re.sub(r"\[(?=.*\][(\[])", "&#91;", line)


@lru_cache(maxsize=1)
def _environments() -> tuple[Environment, Environment]:
    html = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    html.filters.update(number=number, percent=percent, table=_markdown_table)
    return html, html.overlay(autoescape=False, finalize=as_markdown)


def _markdown_table(table: Table) -> Markup:
    rows = [[as_markdown(cell) for cell in row] for row in table.rows]
    return Markup(markdown_table(table.head or ("", ""), rows))
