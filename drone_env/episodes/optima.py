"""The optima of the maps that were flown: solved once, in the background, and kept."""

import logging
import threading
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from typing import Protocol

from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.episodes.database import Database
from drone_env.errors import StoreError, UnknownNameError
from drone_env.planning.optimal import best_of

KEEP_SECONDS = 0.1
log = logging.getLogger(__name__)


class Flown(Protocol):
    """A map that was flown."""

    @property
    def task(self) -> str: ...  # noqa: D102
    @property
    def task_version(self) -> int: ...  # noqa: D102
    @property
    def seed(self) -> int: ...  # noqa: D102
    @property
    def solved(self) -> bool:
        """Whether it has been given to the solver."""
        ...


class Optima:
    """Solves maps in a thread per task: one task may have to compile for seconds while another needs 1 ms."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._closing = threading.Event()
        self._threads = ThreadPoolExecutor(len(TASKS), "drone_env-optima")
        self._lock = threading.Lock()
        self._jobs: dict[TaskConfig, Future[None]] = {}

    def solve_maps_of(self, rows: Iterable[Flown], patience: float) -> bool:
        """Have the maps solved that were never given to the solver; whether there were any.

        A task that is being worked on is left to that. Waits for up to `patience` seconds. What goes wrong is logged,
        and tried again by the next call, which returns what is known until then.
        """
        unsolved: dict[TaskConfig, list[int]] = {}
        for row in rows:
            if not row.solved:
                with suppress(UnknownNameError):  # of a plugin that is gone: nobody can solve its maps
                    unsolved.setdefault(get_task(row.task, row.task_version), []).append(row.seed)
        for task, seeds in unsolved.items():
            self._solve(task, list(dict.fromkeys(seeds)), patience / len(unsolved))
        return bool(unsolved)

    def close(self) -> None:
        """Stop; waits for the maps that are being solved just now."""
        self._closing.set()
        self._threads.shutdown()

    def _solve(self, task: TaskConfig, seeds: Sequence[int], patience: float) -> None:
        with self._lock:
            if task not in self._jobs:
                self._jobs[task] = self._threads.submit(self._work, task, seeds)
            job = self._jobs[task]
        wait([job], patience)
        with self._lock:
            if job.done() and self._jobs.get(task) is job:
                del self._jobs[task]
        error = job.exception() if job.done() else None
        if error is not None:
            unforeseen = None if isinstance(error, StoreError) else error
            log.warning("optima of %s could not be solved or kept: %s", task.id, error, exc_info=unforeseen)

    def _work(self, task: TaskConfig, seeds: Sequence[int]) -> None:
        solved: list[tuple[str, int, int, float | None]] = []
        kept_at = time.monotonic()
        for seed in seeds:
            if self._closing.is_set():
                break
            best = best_of(task, seed)
            solved.append((task.id, task.version, seed, None if best is None else best.score))
            if time.monotonic() - kept_at > KEEP_SECONDS:
                self._keep(task, solved)
                solved, kept_at = [], time.monotonic()
        self._keep(task, solved)

    def _keep(self, task: TaskConfig, solved: Sequence[tuple[str, int, int, float | None]]) -> None:
        with self._database.writing() as connection:
            self._database.check_task(connection, task, claim=True)
            connection.executemany("INSERT OR IGNORE INTO optima VALUES (?, ?, ?, ?)", solved)
