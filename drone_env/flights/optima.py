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
TASKS_AT_ONCE = 4
log = logging.getLogger(__name__)
Scores = list[float | None]
Submit = Callable[[TaskConfig, Sequence[int]], "Future[Scores]"]
"""Starts `solve_maps` in another process; the future must end when that is closed."""
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
    """Solves maps and stores their optima. The maps of one task are solved in order.

    Args:
        database: The database of the store.
        submit: Starts `solve_maps` in another process; None for the threads of this object.
    """

    def __init__(self, database: Database, submit: Submit | None = None) -> None:
        self._database = database
        self._submit = submit
        self._threads = ThreadPoolExecutor(TASKS_AT_ONCE, "drone_env-optima")
        self._jobs: dict[TaskConfig, Future[None]] = {}
        self._closed = False

    def solve(self, maps: Iterable[Map], patience: float) -> None:
        """Start to solve maps and wait for them.

        If a task has a running job, its new maps wait for the next call. Errors are logged; the next call
        for the same map tries again.

        Args:
            maps: The maps.
            patience: Seconds to wait.
        """
        by_task: dict[TaskConfig, list[int]] = {}
        for task, seed in maps:
            by_task.setdefault(task, []).append(seed)
        running = {task: job for task, job in self._jobs.items() if not job.done()}
        for task, seeds in by_task.items():
            if task not in running:
                running[task] = self._threads.submit(self._solve, task, seeds)
        self._jobs = running
        wait([running[task] for task in by_task], patience)

    def close(self) -> None:
        """Stop without storing unfinished jobs."""
        self._closed = True
        self._threads.shutdown(wait=False, cancel_futures=True)

    def _solve(self, task: TaskConfig, seeds: list[int]) -> None:
        try:
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
