"""All error messages, for reading in one go: `python -m tests.docs.test_messages` writes them to messages.txt."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.tools import ROOT, tracked

LIST = Path(__file__).with_name("messages.txt")
LONGEST = 160
"""Two lines of 80 columns; a placeholder counts as 8."""


def text_of(node: ast.expr) -> str:
    """The text of a string or an f-string, with expressions in braces."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(map(text_of, node.values))
    return f"{{{ast.unparse(node.value)}}}" if isinstance(node, ast.FormattedValue) else ""


def strings(node: ast.AST) -> Iterator[str]:
    """The strings in an expression, without those within f-strings and subscripts."""
    if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str)):
        yield text_of(node)
    elif not isinstance(node, ast.Subscript):
        for child in ast.iter_child_nodes(node):
            yield from strings(child)


def raised(path: Path) -> Iterator[str]:
    """The messages of the exceptions that a file raises; those in variables, from all assignments in the function."""
    for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            assigned = [node for node in ast.walk(function) if isinstance(node, ast.Assign)]
            for node in ast.walk(function):
                if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                    for argument in node.exc.args:
                        yield from strings(argument)
                        names = {name.id for name in ast.walk(argument) if isinstance(name, ast.Name)}
                        for one in assigned:
                            if names & {target.id for target in one.targets if isinstance(target, ast.Name)}:
                                yield from strings(one.value)


def messages() -> str:
    """The messages of the package by file; those of two words are codes and separators."""
    found = {
        name: dict.fromkeys(text for text in raised(ROOT / name) if len(text.split()) > 2)
        for name in tracked("drone_env/*.py")
    }
    return "".join("\n".join([name, *(f"  {text}" for text in found[name]), "\n"]) for name in found if found[name])


def test_the_messages_are_those_of_the_list() -> None:
    assert messages() == LIST.read_text(encoding="utf-8"), "read what is new, then: python -m tests.docs.test_messages"
    assert not [line for line in messages().splitlines() if len(re.sub(r"{[^}]*}", 8 * "x", line)) > LONGEST]


if __name__ == "__main__":
    LIST.write_text(messages(), encoding="utf-8")
