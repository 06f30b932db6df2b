"""Threads of compiled code, which a fork takes away: GNU's OpenMP ends a process whose parent had used it before."""

import os
from contextlib import suppress
from importlib import import_module
from typing import Any

from drone_env.errors import EpisodeError


class _Process:
    threads_lost = False


def _after_fork() -> None:
    numba: Any = import_module("numba")
    with suppress(ValueError):  # no threads have been started
        if numba.threading_layer() == "omp":
            _Process.threads_lost = import_module("numba.np.ufunc.omppool").openmp_vendor == "GNU"


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


def require_threads(num_threads: int) -> None:
    """See that threads can share a step in this process.

    Raises:
        EpisodeError: if they cannot, since it was forked from one where they did.
    """
    if _Process.threads_lost:
        raise EpisodeError(
            f"num_threads={num_threads} does not work in a process forked from one that used it: OpenMP would end this "
            "one. Start processes by 'spawn' or 'forkserver', or step with num_threads=1"
        )
