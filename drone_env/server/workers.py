"""Worker processes for long jobs, which must not block the event loop.

Solving a map, flying a pilot, drawing a picture or reading an uploaded file takes up to seconds, and an amount of
memory that depends on the input. A job is a function of a module with arguments that can be pickled. It runs under
limits of CPU time and memory (`drone_env.server.jobs`), and is dropped if its caller disconnects before it runs.

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
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.process import BaseProcess
from typing import Any

from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.envs.registry import plugin_names
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
METHOD = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
OUT_OF_TIME = -signal.SIGXCPU if sys.platform != "win32" else None


@dataclass(frozen=True)
class Job:
    """A waiting or running job."""

    function: Callable[..., Any]
    arguments: tuple[object, ...]
    future: Future[Any] = field(default_factory=Future[Any])


class Workers:
    """The worker processes of one server process. Thread-safe.

    Callers take turns: a free worker runs the oldest job of the next caller.

    Args:
        settings: The settings of the server.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings.model_copy(update={"token": None})
        self._waiting: dict[bool, OrderedDict[str, list[Job]]] = {quick: OrderedDict() for quick in (True, False)}
        self._closed = False
        self._changed = threading.Condition()
        self._workers: list[_Worker] = []

    def submit(
        self, function: Callable[..., Any], *arguments: object, caller: str, task: str | None = None
    ) -> "Future[Any]":
        """Queue a job. Cancelling its future drops it, unless it is running.

        Args:
            function: A function of a module.
            arguments: Its arguments, which are pickled.
            caller: The address of the caller.
            task: The task that bounds the cost; None if the caller's input does. Jobs of registered tasks are quick.

        Raises:
            RequestError: if too many jobs are waiting, or the server is stopping.
        """
        job = Job(function, arguments)
        with self._changed:
            if self._closed:
                raise RequestError(503, "not_started", "the server is stopping")
            waiting = self._waiting[task is not None and is_registered(task)]
            for jobs in waiting.values():
                jobs[:] = [one for one in jobs if not one.future.cancelled()]
            if not in_share(len(waiting.get(caller, ())), sum(map(len, waiting.values())), WAITING):
                raise RequestError(503, "busy", "too many requests are waiting for their turn: try again later")
            waiting.setdefault(caller, []).append(job)
            for number in range(0 if self._workers else PROCESSES):
                self._workers.append(_Worker(partial(self._next, number % 2 == 0), self._settings))
                self._workers[-1].start()
            self._changed.notify_all()
        return job.future

    def warm_up(self) -> None:
        """Start the first worker, which takes about two seconds, before a visitor needs it."""
        if not self._workers:
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
                job.future.cancel()
            self._changed.notify_all()
        for worker in self._workers:
            if worker.process is not None:
                worker.process.terminate()
            worker.join(2)  # one that is starting a process may take longer; threads are daemons

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
                if job is not None and job.future.set_running_or_notify_cancel():
                    return job
        return None


class _Worker(threading.Thread):
    """A thread that runs jobs in a process, one after another.

    Args:
        next_job: Waits for the next job; None when there is none any more.
        settings: The settings of the server.
    """

    def __init__(self, next_job: Callable[[], Job | None], settings: Settings) -> None:
        super().__init__(name="drone_env-worker", daemon=True)
        self._next = next_job
        self._settings = settings
        self.process: BaseProcess | None = None

    def run(self) -> None:
        """Run all jobs."""
        leave_ctrl_c()
        while (job := self._next()) is not None:
            try:
                if self.process is None or not self.process.is_alive():
                    self._start()
                result, error = self._run(job)
            except (EOFError, OSError) as failure:
                result, error = None, RequestError(503, "busy", f"no worker can be started: {failure}")
            except Exception:  # for example arguments that cannot be pickled; the next job must still run
                log.exception("%s failed", job.function)
                result, error = None, RequestError(500, "internal", FAILED)
            if error is None:
                job.future.set_result(result)
            else:
                job.future.set_exception(error)

    def _start(self) -> None:
        context: Any = multiprocessing.get_context(METHOD)
        if METHOD == "forkserver":
            context.set_forkserver_preload(["__main__", "drone_env.server.worker_preload"])
        self._connection, theirs = context.Pipe()
        arguments = theirs, self._connection, self._settings, (plugin_names(), TASKS, REWARD_PROFILES)
        process = context.Process(target=serve, args=arguments, daemon=True)
        process.start()
        self.process = process
        theirs.close()

    def _run(self, job: Job) -> tuple[Any, DroneEnvError | None]:
        """Run a job, and return its result and its error."""
        assert self.process is not None
        try:
            self._connection.send((job.function, job.arguments))
            return self._connection.recv()
        except (EOFError, OSError):
            self.process.join()
            status = self.process.exitcode
        if status == -signal.SIGTERM:  # the server stops, or all processes of the group were told to stop
            return None, RequestError(503, "busy", "the worker was stopped: try again later")
        if status == OUT_OF_TIME:
            limit = self._settings.job_seconds
            return None, TooLargeError(f"this takes more than {limit} s of CPU time, the limit for one request")
        log.warning("a worker ended with status %s while it ran %s", status, job.function.__qualname__)
        return None, RequestError(500, "internal", FAILED)
