"""Where compiled code is kept between runs.

Numba keys its cache by the one file that a function stands in; ours call each other across files. So each state of the
sources gets a folder of its own, named by a hash of all of them.
"""

import hashlib
import os
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numba  # pyright: ignore[reportMissingTypeStubs]


@lru_cache(maxsize=1)
def cache_folder() -> Path:
    """The folder for this state of the sources; made if need be.

    Under `DRONE_ENV_CACHE` if that is set, else under the user's cache folder, else (where that cannot be written)
    under the folder for temporary files.
    """
    digest = hashlib.sha256(numba.__version__.encode())
    for package in ("core", "planning"):
        for file in sorted((Path(__file__).parents[1] / package).glob("*.py")):
            digest.update(file.read_bytes())
    name = digest.hexdigest()[:16]
    chosen = os.environ.get("DRONE_ENV_CACHE")
    if chosen:
        folder = Path(chosen) / name
        folder.mkdir(parents=True, exist_ok=True)
        return folder
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "drone_env" / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    if not writable:
        folder = Path(tempfile.gettempdir()) / f"drone_env-{os.getuid() if hasattr(os, 'getuid') else 'user'}" / name
        folder.mkdir(parents=True, exist_ok=True)
    return folder


@contextmanager
def cached_on_disk() -> Generator[None, None, None]:
    """Functions that are decorated with `cache=True` inside are cached in `cache_folder()`."""
    config: Any = import_module("numba.core.config")
    before = config.CACHE_DIR
    config.CACHE_DIR = str(cache_folder())
    try:
        yield
    finally:
        config.CACHE_DIR = before


def tell_before_compiling() -> None:
    """Say on standard error that a wait is coming, if nothing has been compiled into the cache yet."""
    if not any(cache_folder().rglob("*.nbc")):
        print(
            f"drone_env: compiling the simulator for the first time, a few seconds; kept in {cache_folder()}",
            file=sys.stderr,
        )
