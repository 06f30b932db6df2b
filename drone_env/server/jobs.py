"""The main function of a worker process, the limits of its jobs, and the state that its jobs share."""

import logging
import os
import signal
import sys
from contextlib import suppress
from functools import lru_cache
from multiprocessing.connection import Connection
from types import FrameType
from typing import TYPE_CHECKING, Any

import numpy as np

from drone_env.core.episode import Episode
from drone_env.core.rewards import REWARD_PROFILES, RewardProfile
from drone_env.core.tasks import TASK_FINDERS, TASKS, TaskConfig
from drone_env.envs.registry import load_plugins
from drone_env.errors import DroneEnvError, TooLargeError
from drone_env.files import MAPS
from drone_env.server.drawn_maps import DrawnMaps
from drone_env.server.exceptions import FAILED, RequestError
from drone_env.server.networks import Networks
from drone_env.server.settings import Settings

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver
if sys.platform != "win32":
    import resource

log = logging.getLogger(__name__)
CACHED_SOLVERS = 8
"""Maps whose exact values a process caches; a map of skyline_hard takes 2 MB."""

Registered = tuple[dict[str, TaskConfig], dict[str, RewardProfile]]
"""The tasks and reward profiles of the server."""


class JobContext:
    """State that the jobs of a process share: networks, and the maps solved last.

    Args:
        settings: The settings of the server.
    """

    def __init__(self, settings: Settings) -> None:
        self.networks = Networks(settings.weights, settings.data)
        self.is_new = True
        """Whether this process runs its first job."""
        self._solver_of = lru_cache(CACHED_SOLVERS)(_solve)

    def solver_of(self, task: TaskConfig, seed: int) -> "Solver":
        """Return the exact values of a map.

        Raises:
            TooLargeError: if solving it takes too much memory, even in a new process.
        """
        try:
            return self._solver_of(task, seed)
        except MemoryError:
            self.require_new()
            raise TooLargeError(f"the exact values of this map of {task.id!r} take too much memory") from None

    def require_new(self) -> None:
        """Call this when memory has run out. If this process has run other jobs, a new one repeats the job."""
        if not self.is_new:
            sys.exit()


def _solve(task: TaskConfig, seed: int) -> "Solver":
    from drone_env.planning.optimal import solver_of  # loads Numba, which server processes do not need

    return solver_of(Episode(task, seed=seed))


_contexts: list[JobContext] = []


def job_context() -> JobContext:
    """The state that the jobs of this process share."""
    return _contexts[0]


def serve(
    connection: Connection, others: Connection, settings: Settings, environment: dict[str, str], registered: Registered
) -> None:
    """Run jobs until the server closes the connection.

    Args:
        connection: Receives functions and arguments, sends results and errors.
        others: The server's end. It is closed here, so that the worker notices if the server dies.
        settings: The settings of the server.
        environment: Environment variables of the server.
        registered: The tasks and reward profiles of the server.
    """
    others.close()
    os.environ.update(environment)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server handles Ctrl-C
    if sys.platform != "win32":
        with suppress(OSError):
            os.nice(10)  # stepping has priority
    load_plugins()
    TASKS.update(registered[0])
    REWARD_PROFILES.update(registered[1])
    TASK_FINDERS.append(DrawnMaps(settings.data / MAPS, settings.maps).find)
    context = JobContext(settings)
    _contexts.append(context)
    # OpenBLAS allocates its buffer at the first large product, and ends the process if it cannot.
    _ = np.ones((512, 512)) @ np.ones((512, 512))
    limits = Limits(settings)
    while True:
        try:
            function, arguments = connection.recv()
        except (EOFError, OSError):
            return
        result: Any = None
        error: DroneEnvError | None = None
        try:
            with limits:
                result = function(*arguments)
        except DroneEnvError as raised:
            error = raised
        except MemoryError:
            context.require_new()
            error = TooLargeError(too_much(settings.job_megabytes))
        except Exception:
            log.exception("%s failed", function.__qualname__)
            error = RequestError(500, "internal", FAILED)
        context.is_new = False
        connection.send((result, error))


class Limits:
    """Context manager that limits the CPU time and memory of a job. Memory only on Linux, nothing on Windows.

    A `TooLargeError` interrupts Python code. It cannot interrupt compiled code, so the kernel kills the process after
    twice the time. Numba's compilation does not count, because it happens once per machine.

    Args:
        settings: The settings of the server.
    """

    def __init__(self, settings: Settings) -> None:
        self.seconds = settings.job_seconds
        self._allowed = _allocated() + (settings.job_megabytes << 20)
        if sys.platform != "win32":
            from numba.core import event

            limits, depth = self, 0

            class Compiling(event.Listener):
                def on_start(self, event: event.Event) -> None:
                    nonlocal depth
                    depth += 1
                    if depth == 1:
                        limits.__exit__()
                        limits._allowed -= _allocated()

                def on_end(self, event: event.Event) -> None:
                    nonlocal depth
                    depth -= 1
                    if depth == 0:
                        limits._allowed += _allocated()
                        limits.__enter__()

            event.register("numba:compile", Compiling())
            signal.signal(signal.SIGPROF, self._interrupt)
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    def __enter__(self) -> None:
        """Set the limits."""
        if sys.platform != "win32":
            used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
            _set_soft_limit(resource.RLIMIT_CPU, int(used) + 2 * self.seconds)
            if sys.platform == "linux":
                _set_soft_limit(resource.RLIMIT_DATA, self._allowed)
            signal.setitimer(signal.ITIMER_PROF, self.seconds)

    def __exit__(self, *error: object) -> None:
        """Lift the limits."""
        if sys.platform != "win32":
            signal.setitimer(signal.ITIMER_PROF, 0)
            for kind in (resource.RLIMIT_CPU, resource.RLIMIT_DATA):
                _set_soft_limit(kind, resource.getrlimit(kind)[1])

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        raise TooLargeError(too_long(self.seconds))


def too_much(megabytes: int) -> str:
    """The message of a job that needs too much memory."""
    return f"this takes more than {megabytes} MB of memory, the limit for one request"


def too_long(seconds: int) -> str:
    """The message of a job that needs too much CPU time."""
    return f"this takes more than {seconds} s of CPU time, the limit for one request"


def _allocated() -> int:
    """Return the allocated bytes, as the kernel counts them for `RLIMIT_DATA`; 0 except on Linux."""
    if sys.platform != "linux":
        return 0
    with open("/proc/self/status", encoding="ascii") as status:
        return int(next(line for line in status if line.startswith("VmData:")).split()[1]) << 10


def _set_soft_limit(kind: int, limit: int) -> None:
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
