"""What can still be reached on the maps that are looked at: exact solvers, made in the background, once for all."""

import asyncio
import logging
import threading
from collections import Counter, OrderedDict
from collections.abc import Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import TYPE_CHECKING

from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import TooLargeError
from drone_env.server.problems import RequestError

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver

log = logging.getLogger(__name__)

MAX_BYTES = 256 << 20
"""Memory that the solvers may take together; a map of skyline_hard takes 3 MB, one of another task up to 1 GB."""
UNSOLVED = "What can still be reached on this map could not be worked out; the server's log says why."
Map = tuple[TaskConfig, int]


class ExactValues:
    """The solvers of the maps that were asked for last; safe to share between threads."""

    def __init__(self) -> None:
        self._solvers: OrderedDict[Map, Solver] = OrderedDict()
        self._pending: dict[Map, Future[Solver]] = {}
        self._waiting: Counter[Map] = Counter()
        self._lock = threading.Lock()
        # One thread: flying goes before looking on.
        self._thread = ThreadPoolExecutor(1, "drone_env-values")

    def request(self, task: TaskConfig, seed: int) -> "Future[Solver]":
        """Have a map solved from its start, whether or not anybody waits for it.

        The future raises TooLargeError where the map is too large, and RequestError if it failed for another reason,
        which has been logged; the next call tries again.
        """
        key = (task, seed)
        with self._lock:
            solver = self._kept(key)
            if solver is not None:
                done: Future[Solver] = Future()
                done.set_result(solver)
                return done
            if key not in self._pending:
                self._pending[key] = self._thread.submit(self._solve, key)
            return self._pending[key]

    async def solved(self, task: TaskConfig, seed: int) -> "Solver":
        """Wait for the solver of a map. One that nobody waits for any more is not begun; raises as `request`."""
        with self._wanted((task, seed)) as solver:
            # Shielded: others may wait for the same map.
            return await asyncio.shield(asyncio.wrap_future(solver))

    def solver_of(self, task: TaskConfig, seed: int) -> "Solver":
        """The same for threads that may wait."""
        with self._wanted((task, seed)) as solver:
            return solver.result()

    def get(self, task: TaskConfig, seed: int) -> "Solver | None":
        """The solver of a map from its start, None while there is none."""
        with self._lock:
            return self._kept((task, seed))

    def close(self) -> None:
        """Stop; waits for the map that is being solved just now."""
        self._thread.shutdown(cancel_futures=True)

    def _kept(self, key: Map) -> "Solver | None":
        solver = self._solvers.get(key)
        if solver is not None:
            self._solvers.move_to_end(key)
        return solver

    @contextmanager
    def _wanted(self, key: Map) -> "Generator[Future[Solver], None, None]":
        with self._lock:
            self._waiting[key] += 1
        try:
            yield self.request(*key)
        finally:
            with self._lock:
                self._waiting[key] -= 1
                if not self._waiting[key]:
                    del self._waiting[key]
                    if key in self._pending and self._pending[key].cancel():
                        del self._pending[key]

    def _solve(self, key: Map) -> "Solver":
        # Loads Numba, which no server needs that only flies.
        from drone_env.planning.solvers import solver_of

        solver = None
        try:
            solver = solver_of(Episode(key[0], seed=key[1]))
            return solver
        except TooLargeError:
            raise
        except Exception as error:
            log.exception("what can be reached on map %d of %s could not be worked out", key[1], key[0].id)
            raise RequestError(503, "no_values", UNSOLVED) from error
        finally:
            # Whatever went wrong: the next call tries again.
            self._keep(key, solver)

    def _keep(self, key: Map, solver: "Solver | None") -> None:
        with self._lock:
            del self._pending[key]
            if solver is None:
                return
            self._solvers[key] = solver
            while len(self._solvers) > 1 and sum(kept.nbytes for kept in self._solvers.values()) > MAX_BYTES:
                self._solvers.popitem(last=False)
