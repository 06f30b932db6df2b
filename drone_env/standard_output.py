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


class OutputError(Exception):
    """Standard output cannot be written; the cause is the system's error. No OSError, which commands handle."""


class Output(io.TextIOWrapper):
    """Standard output. If it cannot be written, it raises `OutputError`."""

    def write(self, text: str, /) -> int:
        """Write a text."""
        try:
            return super().write(text)
        except OSError as error:
            raise OutputError from error

    def flush(self) -> None:
        """Write what is buffered."""
        try:
            super().flush()
        except OSError as error:
            raise OutputError from error


def guarded(run: Callable[[], int]) -> int:
    """Run a program and return its exit status; 2 if standard output cannot be written.

    If the reader has closed the pipe (`drone-env fly | head`), nothing is printed; else the reason, in one line.
    """
    # Python has None for a closed stream. What replaces standard output cannot be written either.
    sys.stdout = out = sys.stdout or os.fdopen(os.open(os.devnull, os.O_RDONLY), "w", encoding="utf-8")
    sys.stderr = sys.stderr or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="plain")
    if type(out) is io.TextIOWrapper:
        sys.stdout = Output(out.buffer, out.encoding, out.errors, None, out.line_buffering, out.write_through)
    try:
        try:
            return run()
        finally:
            sys.stdout.flush()
    except OutputError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())  # the interpreter flushes it again
        if isinstance(error.__cause__, OSError) and not isinstance(error.__cause__, BrokenPipeError):
            print_error(f"standard output: {error.__cause__.strerror}")
        return 2


def print_error(error: object) -> None:
    """Print an error on standard error."""
    if isinstance(error, OSError) and error.filename and error.strerror:
        error = f"{error.filename}: {error.strerror}"
    also = ", CITY.toml" if isinstance(error, UnknownNameError) and error.kind == "task" else ""  # for commands alone
    print(f"drone-env: {error}{also}", file=sys.stderr)
