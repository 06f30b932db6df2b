"""Standard output that cannot be written, or lacks emoji; errors on standard error."""

import io
import os
import sys
from collections.abc import Callable

from drone_env.errors import UnknownNameError


def guarded(run: Callable[[], int]) -> int:
    """Run a program and return its exit status; 2 if standard output cannot be written.

    If the reader has closed the pipe (`drone-env fly | head`), nothing is printed.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
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
