"""Markdown from the templates in this package. All values are escaped."""

import re
from functools import lru_cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from drone_env.results.tables import number

TEMPLATES = Path(__file__).with_name("templates")
ENTITIES = {letter: f"&#{ord(letter)};" for letter in "|`*\\"} | {"&": "&amp;", "<": "&lt;"}


def render(template: str, **values: Any) -> str:
    """Render a template in `templates/`."""
    return _environment().get_template(template).render(values)


def as_markdown(text: object) -> str:
    """Escape a text for Markdown, in one line: names and errors may come from others."""
    if isinstance(text, Markup):
        return text
    line = re.sub(r"[&<|`*\\]", lambda found: ENTITIES[found[0]], " ".join(str(text).split()))
    # A link needs a second bracket.
    return re.sub(r"\[(?=.*\][(\[])", "&#91;", line)


@lru_cache(maxsize=1)
def _environment() -> Environment:
    markdown = Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        finalize=as_markdown,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    markdown.filters.update(number=number)
    return markdown
