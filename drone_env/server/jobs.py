"""What runs in a worker process: its loop, the limits of a job, and what jobs share.

A process keeps the maps that it solved last, and what it knows of files that have not changed since.
"""

import logging
import os
import signal
import sys
from collections import OrderedDict
from collections.abc import Generator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from types import FrameType
from typing import TYPE_CHECKING, Any

from drone_env.core.episode import Episode
from drone_env.core.rewards import PACKAGE_PROFILES, REWARD_PROFILES, RewardProfile
from drone_env.core.tasks import FINDERS, PACKAGE_TASKS, TASKS, TaskConfig
from drone_env.envs.registry import load_plugins
from drone_env.errors import DroneEnvError, TooLargeError
from drone_env.files import EVALUATIONS, MAPS, RUNS
from drone_env.server.drawn_maps import DrawnMaps
from drone_env.server.evaluations import Evaluations
from drone_env.server.model_runs import ModelRuns
from drone_env.server.predict import Networks
from drone_env.server.problems import FAILED, RequestError
from drone_env.server.settings import Settings

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver
if sys.platform != "win32":
    import resource

log = logging.getLogger(__name__)
CPU_SECONDS = 10
"""CPU time of one job. Python code is interrupted then; compiled code that goes on is killed after as long again."""
MEMORY = 192 << 20
"""Bytes that one job may allocate beside what its process holds already (Linux)."""
KEPT_SOLVERS = 32 << 20
"""Bytes of solved maps that a process keeps; a map of skyline_hard takes 2 MB."""
TOO_LONG = f"this takes more than {CPU_SECONDS} s of CPU time, which is all that one request may use"
TOO_MUCH = f"this takes more than {MEMORY >> 20} MB of memory, which is all that one request may use"


class Bench:
    """What the jobs of a process share.

    Args:
        settings: The configuration of the server.
    """

    def __init__(self, settings: Settings) -> None:
        self.networks = Networks(settings.weights, settings.data)
        self.runs = ModelRuns(settings.data / RUNS)
        self.evaluations = Evaluations(settings.data / EVALUATIONS)
        self._solvers: OrderedDict[tuple[TaskConfig, int], Solver] = OrderedDict()

    def solver_of(self, task: TaskConfig, seed: int) -> "Solver":
        """What can still be reached on a map, from its start.

        Raises:
            TooLargeError: if solving it would take too much memory.
        """
        from drone_env.planning.solvers import solver_of  # loads Numba, which the process that serves does without

        key = (task, seed)
        solver = self._solvers.get(key) or solver_of(Episode(task, seed=seed))
        self._solvers[key] = solver
        self._solvers.move_to_end(key)
        while len(self._solvers) > 1 and sum(kept.nbytes for kept in self._solvers.values()) > KEPT_SOLVERS:
            self._solvers.popitem(last=False)
        return solver


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
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.signal(signal.SIGPROF, _interrupt)
        _lift_limits_while_compiling()
    prepare(settings)
    while True:
        try:
            function, arguments, registered = connection.recv()
        except (EOFError, OSError):
            return
        result: Any = None
        error: DroneEnvError | None = None
        if registered is not None:
            _register(*registered)
        try:
            with limited():
                result = function(*arguments)
        except DroneEnvError as raised:
            error = raised
        except MemoryError:
            error = TooLargeError(TOO_MUCH)
        except Exception:
            log.exception("%s failed", function.__qualname__)
            error = RequestError(500, "internal", FAILED)
        connection.send((result, error))


@contextmanager
def limited() -> Generator[None, None, None]:
    """Limit CPU time and memory inside the block.

    Raises:
        TooLargeError: if it takes longer.
        MemoryError: if it allocates more.
    """
    if sys.platform == "win32":
        yield
        return
    _arm()
    try:
        yield
    finally:
        _disarm()


def _arm() -> None:
    used = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
    _set_soft_limit(resource.RLIMIT_CPU, int(used) + 2 * CPU_SECONDS)
    if sys.platform == "linux":
        with open("/proc/self/status", encoding="ascii") as status:
            held = int(next(line for line in status if line.startswith("VmData:")).split()[1]) << 10
        _set_soft_limit(resource.RLIMIT_DATA, held + MEMORY)
    signal.setitimer(signal.ITIMER_PROF, CPU_SECONDS)


def _disarm() -> None:
    signal.setitimer(signal.ITIMER_PROF, 0)
    for kind in (resource.RLIMIT_CPU, resource.RLIMIT_DATA):
        _set_soft_limit(kind, resource.getrlimit(kind)[1])


def _set_soft_limit(kind: int, limit: int) -> None:
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise TooLargeError(TOO_LONG)


def _lift_limits_while_compiling() -> None:
    """Count no time and memory in which Numba compiles a function of ours: that happens once per machine."""
    from numba.core import event

    class Compiling(event.Listener):
        depth = 0

        def on_start(self, event: event.Event) -> None:
            self.depth += 1
            _disarm()

        def on_end(self, event: event.Event) -> None:
            self.depth -= 1
            if not self.depth:
                _arm()

    event.register("numba:compile", Compiling())
