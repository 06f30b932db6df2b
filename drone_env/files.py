"""Read files that others may have damaged, and write files whole or not at all."""

import json
import os
import stat
import threading
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import Any

from drone_env.errors import InvalidValueError

PLACES = {"": "data", "results": "results", "sweep": "runs/sweep"}
"""Where the parts of what is kept lie in the working directory."""
RUNS, EVALUATIONS, MAPS = "llm", "evaluations", "maps"
"""Folders in the data folder: of the runs of language models and of evaluations, which a server ranks, and of the maps
that were drawn on its page."""


def data_folder(part: str = "") -> Path:
    """The folder of what is kept, unless a command names another, or of a part: `results` or `sweep`.

    `DRONE_ENV_DATA` names the one folder of all; without it, parts lie in the working directory, as `PLACES` says.
    """
    configured = os.environ.get("DRONE_ENV_DATA")
    return Path(configured, part) if configured else Path(PLACES[part])


def open_file(path: str | Path) -> BufferedReader:
    """Open a regular file, or a link to one, to read bytes.

    Reading anything else may block (a pipe), never end (a device) or fail late (a folder).

    Raises:
        OSError: if it cannot be opened.
        InvalidValueError: if it is not a regular file.
    """
    _require_regular(path, os.stat(path))
    # The path may lead elsewhere by now: a pipe opened without O_NONBLOCK waits for a writer.
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    try:
        _require_regular(path, os.fstat(descriptor))
    except BaseException:
        os.close(descriptor)
        raise
    return open(descriptor, "rb")


def _require_regular(path: str | Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        kind = "a folder" if stat.S_ISDIR(status.st_mode) else "a pipe, socket or device"
        raise InvalidValueError(f"{path} is {kind}; only regular files are read")


def read_file(path: str | Path, most: int) -> bytes:
    """Read a regular file of at most `most` bytes.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if it is not a regular file, or is too large.
    """
    with open_file(path) as file:
        too_large = os.fstat(file.fileno()).st_size > most
        content = b"" if too_large else file.read(most + 1)
    if too_large or len(content) > most:
        raise InvalidValueError(f"{path} is too large: at most {most:,} bytes are read")
    return content


def read_lines(path: str | Path, most: int) -> Iterator[bytes]:
    """The lines of a regular file of any size, each of at most `most` bytes and with its line end.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if it is not a regular file, or at a line that is too long.
    """
    with open_file(path) as file:
        number = 1
        while line := file.readline(most + 1):
            if len(line) > most:
                raise InvalidValueError(f"line {number} of {path} is too long: at most {most:,} bytes are read")
            yield line
            number += 1


@contextmanager
def replacing(path: Path) -> Generator[Path, None, None]:
    """A temporary path beside `path`, to be written inside the `with`; at its end it takes the place of `path`.

    On an error inside, the temporary file is removed and what stood at `path` is left as it was. What is no file but,
    for example, a device or a pipe is written to as it stands.
    """
    as_it_is = path.exists() and not path.is_file() and not path.is_dir()
    temporary = path if as_it_is else path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}.part")
    try:
        yield temporary
        if not as_it_is:
            temporary.replace(path)
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)  # a full disk is reported without it
        raise
    finally:
        if not as_it_is:
            temporary.unlink(missing_ok=True)


def stamp(path: Path) -> tuple[int, int, int] | None:
    """What tells a file from the one that stood there before; None where there is none.

    Raises:
        OSError: if the system does not tell.
    """
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def write_text(path: Path, text: str) -> None:
    """Write a file in UTF-8, whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a JSON file, whole or not at all; a number that JSON does not have is a fault of ours."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


@contextmanager
def locked(path: Path, taken: str, seconds: float = 0.0) -> Generator[None, None, None]:
    """A lock that a file stands for, which is made; no other gets one before the end of the `with` or of this process.

    Args:
        path: The file.
        taken: The message where another has the lock.
        seconds: How long to wait for another to release it.

    Raises:
        InvalidValueError: if another has one still.
        OSError: if the file cannot be made.
    """
    from filelock import FileLock, Timeout  # slow to load, and most who import this module lock nothing

    lock = FileLock(path, timeout=seconds, mode=0o600, thread_local=False)
    try:
        lock.acquire(poll_interval=0.2)
    except Timeout:
        raise InvalidValueError(taken) from None
    try:
        yield
    finally:
        lock.release()


def is_begun(folder: Path, config: str, what: str) -> bool:
    """Whether a folder holds `what`, such as "a sweep", already: a file that says which, called `config`.

    Raises:
        InvalidValueError: if it is a file, or holds anything but what was killed at its very start.
    """
    if folder.exists() and not folder.is_dir():
        raise InvalidValueError(f"{folder} is a file; {what} needs a folder")
    if (folder / config).exists():
        return True
    if folder.is_dir() and any(entry.name != "lock" and entry.suffix != ".part" for entry in folder.iterdir()):
        raise InvalidValueError(f"{folder} holds other things than {what}: name a new folder")
    return False


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """What differs between two configurations, one line for each name."""
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    return [f"{name}: {before.get(name)!r} is now {now.get(name)!r}" for name in names]
