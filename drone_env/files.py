"""Files that are there whole or not at all."""

import os
import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

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


def lock_file(path: Path) -> "FileLock":
    """A lock that this file stands for, which is made; until it is released, or this process dies, no other gets one.

    Raises:
        BlockingIOError: if another has one.
        OSError: if the file cannot be made.
    """
    from filelock import FileLock, Timeout  # slow to load, and most who import this module lock nothing

    lock = FileLock(path, mode=0o600, thread_local=False)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise BlockingIOError(f"{path} is locked by another process") from None
    return lock
