"""Files that are there whole or not at all."""

import json
import os
import threading
from collections.abc import Generator, Mapping
from contextlib import contextmanager
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


@contextmanager
def replacing(path: Path) -> Generator[Path, None, None]:
    """A temporary path beside `path`, to be written inside the `with`; at its end it takes the place of `path`.

    On an error inside, the temporary file is removed and what stood at `path` is left as it was. What is no file but,
    for example, a device or a pipe is written to as it stands.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        yield path
        return
    temporary = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}.part")
    try:
        yield temporary
        temporary.replace(path)
    finally:
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
