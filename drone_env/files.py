"""Read untrusted files within limits, and write files atomically."""

import json
import os
import threading
from collections.abc import Generator, Iterator, Mapping
from contextlib import contextmanager
from io import BufferedReader, FileIO
from pathlib import Path
from typing import Any, Literal

from drone_env.errors import InvalidValueError

RUNS, EVALUATIONS, MAPS = "llm", "evaluations", "maps"
"""Folders in the data folder: runs of language models, evaluations, and maps that were drawn on the page."""


def data_folder(part: Literal["", "results"] = "") -> Path:
    """Return the default folder of stored data, or that of curves: in `DRONE_ENV_DATA`, else `data` and `results`."""
    configured = os.environ.get("DRONE_ENV_DATA")
    return Path(configured, part) if configured else Path(part or "data")


def _opened(path: str | Path) -> BufferedReader:
    if Path(path).exists() and not Path(path).is_file():
        raise InvalidValueError(f"{path} is not a regular file")  # a pipe would block, and a device never end
    return open(path, "rb")


def read_file(path: str | Path, most: int) -> bytes:
    """Read a file of at most `most` bytes.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if it is too large, or a folder, pipe or device.
    """
    with _opened(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise InvalidValueError(f"{path} is too large: at most {most:,} bytes are read")
    return content


def read_lines(path: str | Path, most: int) -> Iterator[bytes]:
    """Yield the lines of a file of any size, each of at most `most` bytes and with its line end.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: if a line is too long, or it is a folder, pipe or device.
    """
    with _opened(path) as file:
        number = 1
        while line := file.readline(most + 1):
            if len(line) > most:
                raise InvalidValueError(f"line {number} of {path} is too long: at most {most:,} bytes are read")
            yield line
            number += 1


@contextmanager
def replacing(path: Path) -> Generator[Path, None, None]:
    """Yield a temporary path to write to, which replaces `path` at the end of the `with`; folders are made.

    If an error occurs, the temporary file is removed and `path` is unchanged.
    """
    temporary = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}.part")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        if error.errno is not None and error.filename is None:
            error.filename = str(path)  # missing if the disk is full
        raise
    finally:
        temporary.unlink(missing_ok=True)


def file_identity(path: Path) -> tuple[int, int, int] | None:
    """Return values that change when the file changes; None if there is none.

    Raises:
        OSError: if they cannot be read.
    """
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def write_text(path: Path, text: str) -> None:
    """Write a file in UTF-8, atomically."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write a JSON file atomically."""
    write_text(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def append_line(file: FileIO, line: str) -> None:
    """Append a line to a file that is opened without a buffer: all of it, or nothing.

    Raises:
        OSError: if it cannot be written.
    """
    data = f"{line}\n".encode()
    written = file.write(data)
    if written != len(data):
        # The next line would continue this one.
        file.truncate(file.tell() - written)
        raise OSError(f"a line could not be written whole to {file.name}")


@contextmanager
def locked(path: Path, taken: str) -> Generator[None, None, None]:
    """Hold an exclusive lock on a file until the end of the `with` or of this process; file and folders are made.

    Args:
        path: The file.
        taken: The error message if another process holds the lock.

    Raises:
        InvalidValueError: if another process holds the lock, or has just removed its folder.
        OSError: if the file cannot be created.
    """
    from filelock import FileLock, Timeout  # slow to load, and seldom needed

    lock = FileLock(path, timeout=0, mode=0o600, thread_local=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except (Timeout, FileNotFoundError, FileExistsError):
        if path.parent.is_file():
            raise
        raise InvalidValueError(taken) from None
    try:
        yield
    finally:
        lock.release()


def is_begun(folder: Path, config: str, what: str) -> bool:
    """Return whether a folder contains the file `config` of an earlier start of `what`, such as "a run".

    Raises:
        InvalidValueError: if it is a file, or contains other files than a process leaves that is killed at its start.
    """
    if folder.exists() and not folder.is_dir():
        raise InvalidValueError(f"{folder} is a file; {what} needs a folder")
    # The config last: another process may begin meanwhile, and the other files come after it.
    names = os.listdir(folder) if folder.exists() else []
    begun = (folder / config).exists()
    if not begun and any(name != "lock" and not name.endswith(".part") for name in names):
        raise InvalidValueError(f"{folder} contains other files than {what}: name a new folder")
    return begun


def differences(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Describe the differences between two configurations, one line for each name."""
    names = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    return [f"{name}: {before.get(name)!r} is now {now.get(name)!r}" for name in names]
