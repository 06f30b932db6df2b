"""The optima of flown maps: each map is solved once, and its optimum is stored."""

import logging
import threading
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from functools import partial
from itertools import islice

from drone_env.core.tasks import TaskConfig
from drone_env.errors import DroneEnvError, TooLargeError
from drone_env.flights.database import Database
from drone_env.planning.optimal import best_of

SOLVE_SECONDS = 0.1
MAPS_AT_ONCE = 100
"""Maximum number of maps per job."""
WAITING = 4
"""Maximum number of callers that wait at once; others return without waiting, so that threads stay free."""
log = logging.getLogger(__name__)
Scores = list[float | None]
Submit = Callable[[TaskConfig, Sequence[int]], "Future[Scores]"]
"""Starts `solve_maps` in another process."""
Map = tuple[TaskConfig, int]


def solve_maps(task: TaskConfig, seeds: Sequence[int]) -> Scores:
    """Return the optima of the first maps, at least one, until `SOLVE_SECONDS` have passed; None if unknown."""
    deadline, scores = time.monotonic() + SOLVE_SECONDS, Scores()
    for seed in seeds:
        best = best_of(task, seed)
        scores.append(None if best is None else best.score)
        if time.monotonic() > deadline:
            break
    return scores


class Optima:
    """Solves maps, one job per task at a time, and stores their optima.

    Args:
        database: The database of the store.
        submit: Starts a job; None for a thread of this object.
    """

    def __init__(self, database: Database, submit: Submit | None = None) -> None:
        self._database = database
        self._thread = ThreadPoolExecutor(1, "drone_env-optima")
        self._submit = submit or partial(self._thread.submit, solve_maps)
        self._unsolved: dict[TaskConfig, dict[int, None]] = {}
        self._changed = threading.Condition()
        self._waiting = threading.Semaphore(WAITING)
        self._closed = False

    def solve(self, maps: Collection[Map], patience: float = 0) -> None:
        """Start to solve maps and wait for them, unless `WAITING` callers are waiting.

        Errors are logged; the next call for the same map tries again.

        Args:
            maps: The maps.
            patience: Seconds to wait.
        """
        with self._changed:
            idle = {task for task, _ in maps} - self._unsolved.keys()
            for task, seed in maps:
                self._unsolved.setdefault(task, {})[seed] = None
            for task in idle:
                self._start(task)
        if patience and self._waiting.acquire(blocking=False):
            try:
                with self._changed:
                    self._changed.wait_for(
                        lambda: not any(seed in self._unsolved.get(task, ()) for task, seed in maps), patience
                    )
            finally:
                self._waiting.release()

    def close(self) -> None:
        """Stop without storing unfinished jobs."""
        self._closed = True
        self._thread.shutdown(cancel_futures=True)

    def _start(self, task: TaskConfig) -> None:
        """Start the next job of a task; the caller holds the lock."""
        seeds = list(islice(self._unsolved[task], MAPS_AT_ONCE))
        try:
            job = self._submit(task, seeds)
        except (DroneEnvError, RuntimeError) as error:  # too many jobs, or a closed pool
            job = Future[Scores]()
            job.set_exception(error)
        job.add_done_callback(partial(self._store, task, seeds))

    def _store(self, task: TaskConfig, seeds: Sequence[int], job: "Future[Scores]") -> None:
        """Store the optima of a finished job and start the next."""
        scores: Scores = []
        try:
            try:
                scores = job.result()
            except TooLargeError:
                scores = [None]
            if not self._closed:
                rows = [(task.id, task.version, seed, score) for seed, score in zip(seeds, scores, strict=False)]
                with self._database.writing() as connection:
                    self._database.check_task(connection, task, claim=True)
                    connection.executemany("INSERT OR IGNORE INTO optima VALUES (?, ?, ?, ?)", rows)
        except (CancelledError, Exception) as error:
            scores = []
            if not self._closed:
                expected = isinstance(error, DroneEnvError | CancelledError)
                message = "optima of %s could not be solved or stored: %s"
                log.warning(message, task.id, error, exc_info=None if expected else error)
        with self._changed:
            left = self._unsolved.pop(task)
            for seed in seeds[: len(scores)]:
                del left[seed]
            if left and scores and not self._closed:
                self._unsolved[task] = left
                self._start(task)
            self._changed.notify_all()
