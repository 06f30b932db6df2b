"""The pages of the documentation and their code blocks. A hidden comment above a block describes it:

<!-- not run: REASON -->             the block is only checked, not run
<!-- not run (COMMAND): REASON -->   likewise its commands that begin with COMMAND; any number of these
<!-- output of: COMMAND -->          the block is what COMMAND prints
<!-- file: NAME -->                  the block is a file that the page's commands find under this name
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    page
    for pattern in ("*.md", "docs/**/*.md", "examples/**/*.md", "leaderboard/*.md")
    for page in ROOT.glob(pattern)
    if "node_modules" not in page.parts
)
MARK = re.compile(r"<!--\s*(not run|output of|file)\s*(?:\(([^)]*)\))?:\s*(.*?)\s*-->", re.DOTALL)


@dataclass
class Block:
    """One fenced code block.

    Attributes:
        where: Page and line, for messages.
        line: The line of its fence, from 1.
        language: The first word after the fence.
        text: Its content.
        not_run: Why the whole block is not run, or None.
        skipped: Beginnings of the commands that are not run, and why.
        output_of: The command that prints it, or None.
        file: The name under which commands of the page find it, or None.
    """

    where: str
    line: int
    language: str
    text: str
    not_run: str | None = None
    skipped: dict[str, str] = field(default_factory=dict)
    output_of: str | None = None
    file: str | None = None


def blocks(page: Path) -> list[Block]:
    """All code blocks of a page, in their order.

    Raises:
        ValueError: if there is an indented code block, or a last comment that no block follows.
    """
    name = page.relative_to(ROOT) if page.is_relative_to(ROOT) else page.name
    found: list[Block] = []
    marks: list[tuple[str, str, str]] = []
    for token in MarkdownIt().parse(page.read_text(encoding="utf-8")):
        line = (token.map or [0])[0] + 1
        where = f"{name}:{line}"
        if token.type == "code_block":
            raise ValueError(f"{where}: code that is indented; put it into a fence that names its language")
        if token.type == "html_block":
            marks += _marks(token.content)
        elif token.type == "fence":
            block = Block(where, line, token.info.partition(" ")[0], token.content)
            _apply(block, marks)
            found.append(block)
            marks = []
    if marks:
        raise ValueError(f"{name}: no code block follows the last comment")
    return found


def _marks(html: str) -> Iterator[tuple[str, str, str]]:
    for kind, command, text in MARK.findall(html):
        yield kind, command, " ".join(text.split())


def _apply(block: Block, marks: list[tuple[str, str, str]]) -> None:
    for kind, command, text in marks:
        if kind == "not run" and command:
            block.skipped[command] = text
        else:
            setattr(block, kind.replace(" ", "_"), text)
