"""Files that are there whole or not at all."""

import os
import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from drone_env.errors import InvalidValueError

if TYPE_CHECKING:
    from filelock import FileLock


@contextmanager
def replacing(path: Path) -> Generator[Path, None, None]:
    """A temporary path beside `path`, to be written inside the `with`; at its end it takes the place of `path`.

    On an error inside, the temporary file is removed and what stood at `path` is left as it was.
    """
    temporary = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}.part")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def lock_file(path: Path, busy: str, seconds: float = 0.0) -> "FileLock":
    """A lock that this file stands for, which is made; until it is released, or this process dies, no other gets one.

    Args:
        path: The file.
        busy: What to say if another process has the lock.
        seconds: How long to wait for that process.

    Raises:
        InvalidValueError: if another process still has it.
        OSError: if the file cannot be made.
    """
    from filelock import FileLock, Timeout  # slow to load, and most who import this module lock nothing

    lock = FileLock(path, mode=0o600, thread_local=False)
    try:
        lock.acquire(timeout=seconds, poll_interval=0.2)
    except Timeout:
        raise InvalidValueError(busy) from None
    return lock
