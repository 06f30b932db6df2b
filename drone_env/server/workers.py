"""Worker processes for long jobs, which must not block the event loop.

Solving a map, flying a pilot, drawing a picture or reading an uploaded file takes up to seconds, and an amount of
memory that depends on the input. A job is a function of a module with arguments that can be pickled. It runs under
limits of CPU time and memory (`drone_env.server.jobs`), and is dropped if its caller disconnects.

The process pools of other packages do not replace this: pebble's, for example, ends all jobs for good when an idle
worker is killed, and limits the time on the clock, which a busy machine takes from everybody.
"""

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
from typing import Any

from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import DroneEnvError, TooLargeError
from drone_env.flights.optima import Scores, solve_maps
from drone_env.flights.sessions import in_share
from drone_env.server.exceptions import FAILED, RequestError
from drone_env.server.jobs import serve
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


class Job(Future[Any]):
    """A waiting or running job."""

    def __init__(self, function: Callable[..., Any], arguments: tuple[object, ...], quick: bool) -> None:
        super().__init__()
        self.function = function
        self.arguments = arguments
        self.quick = quick
        self.worker: BaseProcess | None = None
        self.killed = False
        self.lock = threading.Lock()

    def cancel(self) -> bool:
        """Drop the job, and return whether it was waiting. If it is running and not quick, its worker is killed."""
        if super().cancel():
            return True
        if not self.quick:  # a quick one ends before a new worker would have started
            self.kill()
        return False

    def kill(self) -> None:
        """Kill the worker that runs the job, or is about to."""
        with self.lock:
            self.killed = True
            if self.worker is not None:
                self.worker.kill()


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
        self._changed = threading.Condition()
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
        job = Job(function, arguments, quick=task is not None and is_registered(task))
        with self._changed:
            if self._closed:
                raise RequestError(503, "not_started", "the server is stopping")
            waiting = self._waiting[job.quick]
            for jobs in waiting.values():
                jobs[:] = [one for one in jobs if not one.cancelled()]
            if not in_share(len(waiting.get(caller, ())), sum(map(len, waiting.values())), WAITING):
                raise RequestError(503, "busy", "too many requests are waiting for their turn: try again later")
            waiting.setdefault(caller, []).append(job)
            for number in range(0 if self._threads else PROCESSES):
                name, kind = f"drone_env-worker-{number}", number % 2 == 0
                self._threads.append(threading.Thread(target=self._serve, args=(kind,), name=name, daemon=True))
                self._threads[-1].start()
            self._changed.notify_all()
        return job

    def warm_up(self) -> None:
        """Start the first worker, which takes about two seconds, before a visitor needs it."""
        if not self._threads:
            with suppress(RequestError):
                self.submit(os.getpid, caller="", task=DEFAULT_TASK)

    def solve(self, task: TaskConfig, seeds: Sequence[int]) -> "Future[Scores]":
        """Queue `solve_maps` for the store. Raises as `submit`."""
        return self.submit(solve_maps, task, seeds, caller="store", task=task.id)

    def close(self) -> None:
        """Drop all jobs and end the workers."""
        with self._changed:
            self._closed = True
            for job in [job for kind in self._waiting.values() for jobs in kind.values() for job in jobs]:
                job.cancel()
            for job in self._running:
                job.kill()
            self._changed.notify_all()
        for thread in self._threads:
            thread.join(END_SECONDS)  # a thread that is starting a process may take longer; threads are daemons

    def _serve(self, quick: bool) -> None:
        """Run the jobs of one kind in a process, one after another, until the pool is closed."""
        leave_ctrl_c()
        process: _Process | None = None
        while (job := self._next(quick)) is not None:
            try:
                if process is None or not process.process.is_alive():
                    process = _Process(self._settings)
                result, error = process.run(job)
            except OSError as failure:
                result, error = None, RequestError(503, "busy", f"no worker can be started: {failure}")
            except Exception:  # for example arguments that cannot be pickled; the next job must still run
                log.exception("%s failed", job.function)
                result, error = None, RequestError(500, "internal", FAILED)
            with self._changed:
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
        with self._changed:
            while not self._closed:
                if not waiting:
                    self._changed.wait()
                    continue
                caller, jobs = waiting.popitem(last=False)
                job = jobs.pop(0) if jobs else None
                if jobs:
                    waiting[caller] = jobs
                if job is not None and job.set_running_or_notify_cancel():
                    self._running.add(job)
                    return job
        return None


class _Process:
    """One worker process, which one thread uses."""

    def __init__(self, settings: Settings) -> None:
        context: Any = multiprocessing.get_context(METHOD)
        if METHOD == "forkserver":
            context.set_forkserver_preload(["__main__", "drone_env.server.worker_preload"])
        self._seconds = settings.job_seconds
        self._connection, theirs = context.Pipe()
        arguments = theirs, self._connection, settings, (TASKS, REWARD_PROFILES)
        self.process: BaseProcess = context.Process(target=serve, args=arguments, name="drone_env-worker", daemon=True)
        try:
            self.process.start()
        except EOFError:
            raise ConnectionError("the process that starts them has ended") from None
        theirs.close()

    def run(self, job: Job) -> tuple[Any, DroneEnvError | None]:
        """Run a job, and return its result and its error."""
        with job.lock:
            job.worker = self.process
            if job.killed:
                job.worker.kill()
        try:
            self._connection.send((job.function, job.arguments))
            return self._connection.recv()
        except (EOFError, OSError):
            status = self.end()
        finally:
            with job.lock:
                job.worker = None
        if job.killed:
            return None, RequestError(503, "dropped", "nobody waits for this job any more")
        if status == -signal.SIGTERM:  # for example, all processes of the group were told to stop
            return None, RequestError(503, "busy", "the worker was stopped: try again later")
        if status == OUT_OF_TIME:
            return None, TooLargeError(f"this takes more than {self._seconds} s of CPU time, the limit for one request")
        log.warning("a worker ended with status %s while it ran %s", status, job.function.__qualname__)
        return None, RequestError(500, "internal", FAILED)

    def end(self) -> int | None:
        """End the process, and return its exit status, or minus the number of a signal."""
        self._connection.close()  # ends it unless it is busy
        self.process.join(1)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()
        return self.process.exitcode
