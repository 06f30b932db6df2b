"""Standard output that cannot be written, and errors on standard error."""

import codecs
import io
import os
import sys
from collections.abc import Callable

from drone_env.core.cells import CELL_KINDS, LETTERS, TARGET
from drone_env.errors import UnknownNameError

PLAIN = {kind.emoji: f"{LETTERS[kind.name]} " for kind in CELL_KINDS.values()} | {TARGET: "@ ", "·": ".", "•": "*"}
"""What replaces the symbols of a map that the terminal's encoding lacks; all else that it lacks becomes `?`."""


def _plain(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    return "".join(PLAIN.get(letter, "?") for letter in error.object[error.start : error.end]), error.end


codecs.register_error("plain", _plain)


def guarded(run: Callable[[], int]) -> int:
    """Run a program and return its exit status; 2 if standard output cannot be written.

    If the reader has closed the pipe (`drone-env fly | head`), nothing is printed.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="plain")
    try:
        try:
            return run()
        finally:
            print(end="", flush=True)
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # the interpreter flushes it again
        if not isinstance(error, BrokenPipeError):
            print_error(f"standard output: {error.strerror}")
        return 2


def print_error(error: object) -> None:
    """Print an error on standard error."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        error = f"{error.filename}: {error.strerror}"
    also = ", CITY.toml" if isinstance(error, UnknownNameError) and error.kind == "task" else ""  # for commands alone
    print(f"drone-env: {error}{also}", file=sys.stderr)
