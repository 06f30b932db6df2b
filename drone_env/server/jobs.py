"""What runs in a worker process: its loop, the limits of a job, and what jobs share.

A process keeps the maps that it solved last, and what it knows of files that have not changed since.
"""

import logging
import os
import signal
import sys
from collections import OrderedDict
from contextlib import suppress
from multiprocessing.connection import Connection
from types import FrameType
from typing import TYPE_CHECKING, Any

import numpy as np

from drone_env.core.episode import Episode
from drone_env.core.rewards import PACKAGE_PROFILES, REWARD_PROFILES, RewardProfile
from drone_env.core.tasks import FINDERS, PACKAGE_TASKS, TASKS, TaskConfig
from drone_env.envs.registry import load_plugins
from drone_env.errors import DroneEnvError, TooLargeError
from drone_env.files import MAPS
from drone_env.server.drawn_maps import DrawnMaps
from drone_env.server.model_runs import StoredRuns
from drone_env.server.predict import Networks
from drone_env.server.problems import FAILED, RequestError
from drone_env.server.settings import Settings

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver
if sys.platform != "win32":
    import resource

log = logging.getLogger(__name__)
KEPT_SOLVERS = 16 << 20
"""Bytes of solved maps that a process keeps; a map of skyline_hard takes 2 MB."""
GROWTH = 32 << 20
"""Bytes by which a process may grow over its jobs; then another takes its place."""

NEXT, LAST, AGAIN = range(3)
"""What a process does after a job: take the next, end, or end because the job needs a new process."""


class FullError(BaseException):
    """Memory ran out in a process that keeps memory of earlier jobs. The job runs again in a new process."""


class Bench:
    """What the jobs of a process share.

    Args:
        settings: The configuration of the server.
    """

    def __init__(self, settings: Settings) -> None:
        self.networks = Networks(settings.weights, settings.data)
        self.runs = StoredRuns(settings.data)
        self._solvers: OrderedDict[tuple[TaskConfig, int], Solver] = OrderedDict()
        self.is_new = True
        """Whether this process runs its first job."""

    def solver_of(self, task: TaskConfig, seed: int) -> "Solver":
        """What can still be reached on a map, from its start.

        Raises:
            TooLargeError: if solving it would take too much memory, even in a new process.
        """
        from drone_env.planning.optimal import solver_of  # loads Numba, which the process that serves does without

        key = (task, seed)
        try:
            solver = self._solvers.get(key) or solver_of(Episode(task, seed=seed))
        except MemoryError:
            self.require_new()
            raise TooLargeError(f"the exact values of this map of {task.id!r} take too much memory") from None
        self._solvers[key] = solver
        self._solvers.move_to_end(key)
        while len(self._solvers) > 1 and sum(kept.nbytes for kept in self._solvers.values()) > KEPT_SOLVERS:
            self._solvers.popitem(last=False)
        return solver

    def require_new(self) -> None:
        """Call this when memory has run out: a process that has run other jobs leaves the job to a new one."""
        if not self.is_new:
            raise FullError


_benches: list[Bench] = []


def bench() -> Bench:
    """What the jobs of this process share."""
    return _benches[0]


def prepare(settings: Settings) -> None:
    """Load the plugins, and make the bench."""
    load_plugins()
    FINDERS.append(DrawnMaps(settings.data / MAPS, settings.maps).find)
    _benches.append(Bench(settings))


def _register(tasks: dict[str, TaskConfig], profiles: dict[str, RewardProfile]) -> None:
    """Have the tasks and reward profiles that the server has."""
    for id_ in TASKS.keys() - PACKAGE_TASKS:
        del TASKS[id_]
    TASKS.update(tasks)
    for id_ in REWARD_PROFILES.keys() - PACKAGE_PROFILES:
        del REWARD_PROFILES[id_]
    REWARD_PROFILES.update(profiles)


def serve(connection: Connection, others: Connection, settings: Settings, environment: dict[str, str]) -> None:
    """Run jobs until the server closes the connection: the main function of a worker process.

    Args:
        connection: Functions and arguments come in, results and errors go out.
        others: The server's end. It is closed here, so that the end of the server is seen.
        settings: The configuration of the server.
        environment: Variables of the server's environment.
    """
    others.close()
    os.environ.update(environment)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the server's to handle
    if sys.platform != "win32":
        with suppress(OSError):
            os.nice(10)  # flying has priority
    prepare(settings)
    # OpenBLAS allocates its buffer with the first large product. If it cannot, it ends the process.
    _ = np.ones((512, 512)) @ np.ones((512, 512))
    limits = Limits(settings)
    while True:
        try:
            function, arguments, registered = connection.recv()
        except (EOFError, OSError):
            return
        if registered is not None:
            _register(*registered)
        result: Any = None
        error: DroneEnvError | None = None
        try:
            with limits:
                result = function(*arguments)
        except DroneEnvError as raised:
            error = raised
        except (FullError, MemoryError):
            if not bench().is_new:
                connection.send((None, None, AGAIN))
                return
            error = TooLargeError(limits.too_much)
        except Exception:
            log.exception("%s failed", function.__qualname__)
            error = RequestError(500, "internal", FAILED)
        bench().is_new = False
        connection.send((result, error, LAST if limits.outgrown else NEXT))


class Limits:
    """Limits the CPU time and memory of a job inside a `with`; nothing on Windows, no memory on other than Linux.

    Python code that runs too long is interrupted by a `TooLargeError`. Compiled code is not; after as long again the
    kernel kills the process. Numba's compiling does not count: it happens once per machine.

    Args:
        settings: The configuration of the server.
    """

    def __init__(self, settings: Settings) -> None:
        self.seconds, self._bytes = settings.job_seconds, settings.job_megabytes << 20
        self.too_much = too_much(settings.job_megabytes)
        self._compiling = 0
        self._first = _allocated()
        self._compilers = 0
        """Bytes that compiling has allocated. They are not the job's."""
        if sys.platform != "win32":
            from numba.core import event

            signal.signal(signal.SIGPROF, self._interrupt)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            limits = self

            class Compiling(event.Listener):
                def on_start(self, event: event.Event) -> None:
                    if not limits._compiling:
                        limits._lift()
                        limits._compilers -= _allocated()
                    limits._compiling += 1

                def on_end(self, event: event.Event) -> None:
                    limits._compiling -= 1
                    if not limits._compiling:
                        limits._compilers += _allocated()
                        limits.__enter__()

            event.register("numba:compile", Compiling())

    @property
    def outgrown(self) -> bool:
        """Whether the process holds more memory than it should keep."""
        return _allocated() > self._first + self._compilers + GROWTH

    def __enter__(self) -> None:
        """Limit time and memory from now on."""
        if sys.platform != "win32":
            used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
            _set_soft_limit(resource.RLIMIT_CPU, int(used) + 2 * self.seconds)
            if sys.platform == "linux":
                _set_soft_limit(resource.RLIMIT_DATA, self._first + self._compilers + self._bytes)
            signal.setitimer(signal.ITIMER_PROF, self.seconds)

    def __exit__(self, *error: object) -> None:
        """Lift the limits."""
        if sys.platform != "win32":
            self._lift()

    def _lift(self) -> None:
        signal.setitimer(signal.ITIMER_PROF, 0)
        for kind in (resource.RLIMIT_CPU, resource.RLIMIT_DATA):
            _set_soft_limit(kind, resource.getrlimit(kind)[1])

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        raise TooLargeError(too_long(self.seconds))


def too_much(megabytes: int) -> str:
    """What a caller is told whose job took too much memory."""
    return f"this takes more than {megabytes} MB of memory, the limit for one request"


def too_long(seconds: int) -> str:
    """What a caller is told whose job took too much CPU time."""
    return f"this takes more than {seconds} s of CPU time, the limit for one request"


def _allocated() -> int:
    """Bytes that this process has allocated, as the kernel counts them for `RLIMIT_DATA`; 0 on other than Linux."""
    if sys.platform != "linux":
        return 0
    with open("/proc/self/status", encoding="ascii") as status:
        return int(next(line for line in status if line.startswith("VmData:")).split()[1]) << 10


def _set_soft_limit(kind: int, limit: int) -> None:
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
