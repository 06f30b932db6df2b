"""The optima of the maps that were flown: each is solved once, in the background, and stored."""

import logging
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
from typing import Protocol

from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import DroneEnvError, UnknownNameError
from drone_env.planning.optimal import best_of
from drone_env.results.database import Database

SOLVE_SECONDS = 0.1
WAITING = 4
"""Callers that wait for optima at once. Others get what is known: threads that wait are missing elsewhere."""
log = logging.getLogger(__name__)
Solve = Callable[[TaskConfig, Sequence[int]], Sequence[float | None]]
"""Returns the optima of the first maps of a task, of one at least; None for a map that is too large to be solved."""


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


def solve_maps(task: TaskConfig, seeds: Sequence[int]) -> list[float | None]:
    """The optima of the first maps, as many as `SOLVE_SECONDS` allow and at least one; None where it is unknown."""
    until, scores = time.monotonic() + SOLVE_SECONDS, list[float | None]()
    for seed in seeds:
        best = best_of(task, seed)
        scores.append(None if best is None else best.score)
        if time.monotonic() > until:
            break
    return scores


class Optima:
    """Solves maps, and stores their optima.

    Args:
        database: Where to.
        solve: Solves them. It is called in a thread per task, since one task may have to compile for seconds.
    """

    def __init__(self, database: Database, solve: Solve = solve_maps) -> None:
        self._database = database
        self._solve = solve
        self._closing = threading.Event()
        self._threads = ThreadPoolExecutor(len(TASKS), "drone_env-optima")
        self._lock = threading.Lock()
        self._waiting = threading.Semaphore(WAITING)
        self._jobs: dict[TaskConfig, Future[None]] = {}

    def solve_maps_of(self, rows: Iterable[Flown], patience: float) -> bool:
        """Start to solve the maps without a stored optimum; whether there were any.

        Waits for up to `patience` seconds, unless `WAITING` callers wait already. A task whose maps are being solved is
        not started again. Errors are logged, and the next call tries again.
        """
        unsolved: dict[TaskConfig, list[int]] = {}
        for row in rows:
            if not row.solved:
                with suppress(UnknownNameError):  # of a plugin that is gone: nobody can solve its maps
                    unsolved.setdefault(get_task(row.task, row.task_version), []).append(row.seed)
        for task, seeds in unsolved.items():
            self._start(task, list(dict.fromkeys(seeds)), patience / len(unsolved))
        return bool(unsolved)

    def close(self) -> None:
        """Stop; waits for the maps that are being solved."""
        self._closing.set()
        self._threads.shutdown()

    def _start(self, task: TaskConfig, seeds: Sequence[int], patience: float) -> None:
        with self._lock:
            if task not in self._jobs:
                self._jobs[task] = self._threads.submit(self._work, task, seeds)
            job = self._jobs[task]
        if self._waiting.acquire(blocking=False):
            try:
                wait([job], patience)
            finally:
                self._waiting.release()
        with self._lock:
            if job.done() and self._jobs.get(task) is job:
                del self._jobs[task]
        error = job.exception() if job.done() else None
        if error is not None:
            foreseen = isinstance(error, DroneEnvError)
            log.warning(
                "optima of %s could not be solved or stored: %s", task.id, error, exc_info=None if foreseen else error
            )

    def _work(self, task: TaskConfig, seeds: Sequence[int]) -> None:
        while seeds and not self._closing.is_set():
            scores = self._solve(task, seeds)
            rows = [(task.id, task.version, seed, score) for seed, score in zip(seeds, scores, strict=False)]
            with self._database.writing() as connection:
                self._database.check_task(connection, task, claim=True)
                connection.executemany("INSERT OR IGNORE INTO optima VALUES (?, ?, ?, ?)", rows)
            seeds = seeds[len(scores) :]
