"""The main function of a worker process, the limits of its jobs, and the state that its jobs share."""

import logging
import os
import signal
import sys
from contextlib import suppress
from functools import lru_cache
from multiprocessing.connection import Connection
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
Registered = tuple[tuple[str, ...], dict[str, TaskConfig], dict[str, RewardProfile]]
"""The plugins, tasks and reward profiles of the server."""


_networks: list[Networks] = []


def job_networks() -> Networks:
    """The networks that the jobs of this process share."""
    return _networks[0]


@lru_cache(maxsize=4)
def solver_of_map(task: TaskConfig, seed: int) -> "Solver":
    """Return the exact values of a map. Cached: the page asks for those of the same map again and again."""
    from drone_env.planning.optimal import solver_of  # loads Numba, which server processes do not need

    return solver_of(Episode(task, seed=seed))


def serve(connection: Connection, others: Connection, settings: Settings, registered: Registered) -> None:
    """Run jobs until the server closes the connection.

    Args:
        connection: Receives functions and arguments, sends results and errors.
        others: The server's end. It is closed here, so that the worker notices if the server dies.
        settings: The settings of the server.
        registered: The plugins, tasks and reward profiles of the server.
    """
    others.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the server handles Ctrl-C
    if sys.platform != "win32":
        os.nice(10)  # stepping has priority
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # the limit of time would leave a dump
        _lift_when_compiling()
    # A process that the forkserver starts has the environment that was there when the forkserver started.
    plugins, tasks, profiles = registered
    load_plugins(plugins)
    TASKS.update(tasks)
    REWARD_PROFILES.update(profiles)
    TASK_FINDERS.append(DrawnMaps(settings.data / MAPS).find)
    _networks.append(Networks(settings.weights, settings.data))
    # OpenBLAS allocates its buffer at the first large product, and ends the process if it cannot.
    _ = np.ones((512, 512)) @ np.ones((512, 512))
    with suppress(EOFError, OSError):
        while True:
            function, arguments = connection.recv()
            result: Any = None
            error: DroneEnvError | None = None
            limit(settings.job_seconds, settings.job_megabytes)
            try:
                result = function(*arguments)
            except DroneEnvError as raised:
                error = raised
            except MemoryError:
                megabytes = settings.job_megabytes
                error = TooLargeError(f"this takes more than {megabytes} MB of memory, the limit for one request")
            except Exception:
                log.exception("%s failed", function.__qualname__)
                error = RequestError(500, "internal", FAILED)
            lift_limits()
            connection.send((result, error))


def limit(seconds: int, megabytes: int) -> None:
    """Limit the CPU time and memory of a job. Memory only on Linux, nothing on Windows.

    The kernel ends a process that takes too long, also in compiled code.
    """
    if sys.platform != "win32":
        used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
        _set_soft_limit(resource.RLIMIT_CPU, int(used) + 1 + seconds)
        if sys.platform == "linux":
            _set_soft_limit(resource.RLIMIT_DATA, _allocated() + (megabytes << 20))


def lift_limits() -> None:
    """Lift the limits of a job."""
    if sys.platform != "win32":
        for kind in (resource.RLIMIT_CPU, resource.RLIMIT_DATA):
            _set_soft_limit(kind, resource.getrlimit(kind)[1])


def _lift_when_compiling() -> None:
    """A job that compiles has no limits, because Numba compiles a function once per machine."""
    from numba.core import event

    class Compiling(event.Listener):
        def on_start(self, event: event.Event) -> None:
            lift_limits()

        def on_end(self, event: event.Event) -> None:
            """The job goes on without limits."""

    event.register("numba:compile", Compiling())


def _allocated() -> int:
    """Return the allocated bytes, as the kernel counts them for `RLIMIT_DATA`."""
    with open("/proc/self/status", encoding="ascii") as status:
        return int(next(line for line in status if line.startswith("VmData:")).split()[1]) << 10


def _set_soft_limit(kind: int, limit: int) -> None:
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
