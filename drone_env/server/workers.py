"""Worker processes for long jobs, which must not block the event loop.

Solving a map, flying a pilot, drawing a picture or reading an uploaded file takes up to seconds, and an amount of
memory that depends on the input. A job is a function of a module with arguments that can be pickled. It runs under
limits of CPU time and memory (`drone_env.server.jobs`), and is dropped if its caller disconnects.
"""

import asyncio
import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import suppress
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import DroneEnvError, TooLargeError
from drone_env.flights.optima import Scores, solve_maps
from drone_env.flights.sessions import in_share
from drone_env.server.exceptions import FAILED, RequestError
from drone_env.server.jobs import serve, too_long, too_much
from drone_env.server.process import leave_ctrl_c
from drone_env.server.settings import Settings
from drone_env.server.task_api import DEFAULT_TASK, is_registered

log = logging.getLogger(__name__)
PROCESSES = max(2, (os.cpu_count() or 1) // 2)
"""Number of workers. Half of them run only quick jobs, so that a slow map does not delay other callers."""
WAITING = 64
"""Most waiting jobs of each kind: quick, and others."""
END_SECONDS = 2
METHOD = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
OUT_OF_TIME = -signal.SIGXCPU if sys.platform != "win32" else None
FINAL = (OUT_OF_TIME, -signal.SIGTERM)
"""Exit statuses of workers whose job is not repeated: it used too much time, or the server is being stopped."""
PRELOADED = ["__main__", "drone_env.server.worker_preload"]
Result = TypeVar("Result")


class Job(Future[Any]):
    """A waiting or running job. `cancel` drops it; if it is running and not quick, its worker is killed."""

    process: BaseProcess | None = None
    dropped = False

    def __init__(
        self, workers: "Workers", function: Callable[..., Any], arguments: tuple[object, ...], quick: bool
    ) -> None:
        super().__init__()
        self.function = function
        self.arguments = arguments
        self.quick = quick
        self._workers = workers

    def cancel(self) -> bool:
        """Drop the job, and return whether it had not ended."""
        return self._workers.drop(self)


class Workers:
    """The worker processes of one server process. Thread-safe.

    Callers take turns: a free worker runs the oldest job of the next caller.

    Args:
        settings: The settings of the server.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings.model_copy(update={"token": None})
        self._waiting: dict[bool, OrderedDict[str, list[Job]]] = {quick: OrderedDict() for quick in (True, False)}
        self._running: set[Job] = set()
        self._closed = False
        self._condition = threading.Condition()
        self._threads: list[threading.Thread] = []

    def submit(self, function: Callable[..., Any], *arguments: object, caller: str, task: str | None = None) -> Job:
        """Queue a job.

        Args:
            function: A function of a module.
            arguments: Its arguments, which are pickled.
            caller: The address of the caller.
            task: The task that bounds the cost; None if the caller's input does. Jobs of registered tasks are quick.

        Raises:
            RequestError: if too many jobs are waiting, or the server is stopping.
        """
        job = Job(self, function, arguments, quick=task is not None and is_registered(task))
        with self._condition:
            if self._closed:
                raise RequestError(503, "not_started", "the server is stopping")
            waiting = self._waiting[job.quick]
            if not in_share(len(waiting.get(caller, ())), sum(map(len, waiting.values())), WAITING):
                raise RequestError(503, "busy", "too many requests are waiting for their turn: try again later")
            waiting.setdefault(caller, []).append(job)
            for number in range(0 if self._threads else PROCESSES):
                name, kind = f"drone_env-worker-{number}", number % 2 == 0
                self._threads.append(threading.Thread(target=self._serve, args=(kind,), name=name, daemon=True))
                self._threads[-1].start()
            self._condition.notify_all()
        return job

    def warm_up(self) -> None:
        """Start the first worker, which takes about two seconds, before a visitor needs it."""
        if not self._threads:
            with suppress(RequestError):
                self.submit(os.getpid, caller="", task=DEFAULT_TASK)

    async def run(
        self, function: Callable[..., Result], *arguments: object, caller: str, task: str | None = None
    ) -> Result:
        """Run a job and return its result. Cancelling drops it. Raises as `submit` and as the function."""
        return await asyncio.wrap_future(self.submit(function, *arguments, caller=caller, task=task))

    def solve(self, task: TaskConfig, seeds: Sequence[int]) -> "Future[Scores]":
        """Queue `solve_maps` for the store. Raises as `submit`."""
        return self.submit(solve_maps, task, seeds, caller="store", task=task.id)

    def drop(self, job: Job) -> bool:
        """Remove a job from the queue or kill its worker, and return whether it had not ended."""
        with self._condition:
            job.dropped = True
            for jobs in self._waiting[job.quick].values():
                if job in jobs:
                    jobs.remove(job)
                    return Future.cancel(job)
            self._kill_dropped(job)
            return job in self._running

    def close(self) -> None:
        """Drop all jobs and end the workers."""
        with self._condition:
            self._closed = True
            waiting = [job for kind in self._waiting.values() for jobs in kind.values() for job in jobs]
            for job in (*waiting, *self._running):
                job.cancel()
            self._condition.notify_all()
        for thread in self._threads:
            thread.join(END_SECONDS)  # a thread that is starting a process may take longer; threads are daemons

    def _serve(self, quick: bool) -> None:
        """Run the jobs of one kind in a process, one after another, until the pool is closed."""
        leave_ctrl_c()
        process: _Process | None = None
        while (job := self._next(quick)) is not None:
            result, error, process = self._run(job, process)
            with self._condition:
                self._running.remove(job)
            if error is None:
                job.set_result(result)
            else:
                job.set_exception(error)
        if process is not None:
            process.end()

    def _next(self, quick: bool) -> Job | None:
        """Wait for the next job; None when the pool is closed."""
        waiting = self._waiting[quick]
        with self._condition:
            while not self._closed:
                while waiting:
                    caller, jobs = waiting.popitem(last=False)
                    if not jobs:
                        continue
                    job = jobs.pop(0)
                    waiting[caller] = jobs
                    job.set_running_or_notify_cancel()
                    self._running.add(job)
                    return job
                self._condition.wait()
        return None

    def _run(self, job: Job, process: "_Process | None") -> "tuple[Any, DroneEnvError | None, _Process | None]":
        """Run a job in a process that has run others, or in a new one.

        If an old process has ended or ends, a new one repeats the job: responses must not depend on earlier requests.

        Returns:
            The result, the error, and the process, which is None if it has ended.
        """
        is_new = process is None
        try:
            process = process or _Process(self._settings)
            with self._condition:
                job.process = process.process
                self._kill_dropped(job)
            process.connection.send((job.function, job.arguments))
            result, error = process.connection.recv()
        except (EOFError, OSError):
            status = None if process is None else process.end()
            error = self._reason(job, status)
            if is_new or job.dropped or status in FINAL:
                return None, error, None
            return self._run(job, None)
        except Exception:  # for example arguments that cannot be pickled; the next job must still run
            log.exception("%s failed", job.function)
            return None, RequestError(500, "internal", FAILED), process
        return result, error, process

    def _kill_dropped(self, job: Job) -> None:
        # A quick job ends soon. A new worker would take longer to start, and has no cached maps.
        if job.dropped and job in self._running and job.process is not None and (self._closed or not job.quick):
            job.process.kill()

    def _reason(self, job: Job, status: int | None) -> DroneEnvError:
        """Return why a worker ended during a job, by its exit status; None if it could not be started."""
        if job.dropped:
            return RequestError(503, "dropped", "nobody waits for this job any more")
        if status in (None, -signal.SIGTERM):  # for example, all processes of the group were told to stop
            return RequestError(503, "busy", "the worker was stopped: try again later")
        if status == OUT_OF_TIME:
            return TooLargeError(too_long(self._settings.job_seconds))
        if status == -signal.SIGABRT:  # LLVM aborts if an allocation fails
            return TooLargeError(too_much(self._settings.job_megabytes))
        if status:
            log.warning("a worker ended with status %s while it ran %s", status, job.function.__qualname__)
        return RequestError(500, "internal", FAILED)


class _Process:
    """One worker process. Only its own thread may use it, but others may kill it."""

    def __init__(self, settings: Settings) -> None:
        context: Any = multiprocessing.get_context(METHOD)
        if METHOD == "forkserver":
            context.set_forkserver_preload(PRELOADED)
        # A forked worker inherits the environment of the forkserver, which may be outdated.
        environment = {name: value for name, value in os.environ.items() if name.startswith("DRONE_ENV_")}
        self.connection, theirs = context.Pipe()
        arguments = theirs, self.connection, settings, environment, (TASKS, REWARD_PROFILES)
        self.process: BaseProcess = context.Process(target=serve, args=arguments, name="drone_env-worker", daemon=True)
        self.process.start()
        theirs.close()

    def end(self) -> int | None:
        """End the process, and return its exit status, or minus the number of a signal."""
        self.connection.close()  # ends it unless it is busy
        self.process.join(1)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        return self.process.exitcode
