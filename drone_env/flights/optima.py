"""The optima of flown maps: each map is solved once, and its optimum is stored."""

import logging
import threading
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from functools import partial

from drone_env.core.tasks import TaskConfig
from drone_env.errors import DroneEnvError, TooLargeError
from drone_env.flights.database import Database
from drone_env.planning.optimal import best_of

SOLVE_SECONDS = 0.1
MAPS_AT_ONCE = 100
"""Maximum number of maps per job."""
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
    """Solves maps, one job at a time, and stores their optima.

    Args:
        database: The database of the store.
        submit: Starts a job; None for a thread of this object.
    """

    def __init__(self, database: Database, submit: Submit | None = None) -> None:
        self._database = database
        self._thread = ThreadPoolExecutor(1, "drone_env-optima")
        self._submit = submit or partial(self._thread.submit, solve_maps)
        self._unsolved: dict[Map, None] = {}
        self._changed = threading.Condition()
        self._closed = False

    def solve(self, maps: Collection[Map], patience: float) -> None:
        """Start to solve maps and wait for them.

        Errors are logged; the next call for the same map tries again.

        Args:
            maps: The maps.
            patience: Seconds to wait.
        """
        with self._changed:
            idle = not self._unsolved
            self._unsolved.update(dict.fromkeys(maps))
            if idle:
                self._start()
            self._changed.wait_for(lambda: self._unsolved.keys().isdisjoint(maps), patience)

    def close(self) -> None:
        """Stop without storing unfinished jobs."""
        self._closed = True
        self._thread.shutdown(cancel_futures=True)

    def _start(self) -> None:
        """Start the next job; the caller holds the lock."""
        task = next(iter(self._unsolved))[0]
        seeds = [seed for known, seed in self._unsolved if known == task][:MAPS_AT_ONCE]
        try:
            job = self._submit(task, seeds)
        except (DroneEnvError, RuntimeError) as error:  # too many jobs, or a closed pool
            job = Future[Scores]()
            job.set_exception(error)
        job.add_done_callback(partial(self._store, task, seeds))

    def _store(self, task: TaskConfig, seeds: Sequence[int], job: "Future[Scores]") -> None:
        """Store the optima of a finished job and start the next."""
        solved: Sequence[int] = ()
        try:
            try:
                scores = job.result()
            except TooLargeError:
                scores = [None]
            if not self._closed:
                rows = [(task.id, task.version, seed, score) for seed, score in zip(seeds, scores, strict=False)]
                with self._database.writing() as connection:
                    connection.executemany("INSERT OR IGNORE INTO optima VALUES (?, ?, ?, ?)", rows)
                solved = seeds[: len(rows)]
        except (CancelledError, Exception) as error:
            if not self._closed:
                expected = isinstance(error, DroneEnvError | CancelledError)
                message = "optima of %s could not be solved or stored: %s"
                log.warning(message, task.id, error, exc_info=None if expected else error)
        with self._changed:
            for seed in solved:
                del self._unsolved[task, seed]
            if not solved:
                self._unsolved.clear()
            if self._unsolved:
                self._start()
            self._changed.notify_all()
