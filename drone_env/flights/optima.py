"""The optima of flown maps: each map is solved once, and its optimum is stored."""

import logging
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor, wait

from drone_env.core.tasks import TaskConfig
from drone_env.errors import DroneEnvError, TooLargeError
from drone_env.flights.database import Database
from drone_env.planning.optimal import best_of

SOLVE_SECONDS = 0.1
MAPS_AT_ONCE = 100
"""Maximum number of maps per job."""
FIND = "SELECT 1 FROM optima WHERE task = ? AND task_version = ? AND seed = ?"
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
    """Solves maps one after another and stores their optima.

    Args:
        database: The database of the store.
        submit: Starts `solve_maps` in another process; None for the thread of this object.
    """

    def __init__(self, database: Database, submit: Submit | None = None) -> None:
        self._database = database
        self._submit = submit
        self._thread = ThreadPoolExecutor(1, "drone_env-optima")
        self._closed = False

    def solve(self, maps: Iterable[Map], patience: float) -> None:
        """Start to solve maps and wait for them.

        Errors are logged; the next call for the same map tries again.

        Args:
            maps: The maps.
            patience: Seconds to wait.
        """
        by_task: dict[TaskConfig, list[int]] = {}
        for task, seed in maps:
            by_task.setdefault(task, []).append(seed)
        wait([self._thread.submit(self._solve, task, seeds) for task, seeds in by_task.items()], patience)

    def close(self) -> None:
        """Stop without storing unfinished jobs."""
        self._closed = True
        self._thread.shutdown(wait=False, cancel_futures=True)

    def _solve(self, task: TaskConfig, seeds: list[int]) -> None:
        try:
            with self._database.reading() as connection:
                # An earlier call may have solved some.
                seeds = [
                    seed for seed in seeds if not connection.execute(FIND, (task.id, task.version, seed)).fetchone()
                ]
            while seeds and not self._closed:
                scores = self._scores(task, seeds[:MAPS_AT_ONCE])
                rows = [(task.id, task.version, seed, score) for seed, score in zip(seeds, scores, strict=False)]
                with self._database.writing() as connection:
                    connection.executemany("INSERT OR IGNORE INTO optima VALUES (?, ?, ?, ?)", rows)
                seeds = seeds[len(rows) :]
        except Exception as error:
            if not self._closed:
                trace = None if isinstance(error, DroneEnvError | CancelledError) else error
                log.warning("optima of %s could not be solved or stored: %s", task.id, error, exc_info=trace)

    def _scores(self, task: TaskConfig, seeds: list[int]) -> Scores:
        try:
            return solve_maps(task, seeds) if self._submit is None else self._submit(task, seeds).result()
        except TooLargeError:
            return [None]
