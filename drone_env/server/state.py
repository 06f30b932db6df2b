"""The state of the application, at `app.state.shared`, and the dependencies of the routes."""

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Annotated, TypeVar

from fastapi import Depends, Request, Response
from starlette.requests import HTTPConnection

from drone_env.core.tasks import TASK_FINDERS
from drone_env.files import MAPS
from drone_env.flights.database import BusyError
from drone_env.flights.sessions import Sessions
from drone_env.flights.store import Store
from drone_env.server.drawn_maps import DrawnMaps
from drone_env.server.exceptions import RequestError, error_responses
from drone_env.server.logs import RequestLog
from drone_env.server.model_runs import Entries
from drone_env.server.networks import Networks
from drone_env.server.settings import Settings
from drone_env.server.workers import Workers

SESSION_ERRORS = error_responses(409, 410, 422, 503)
Result = TypeVar("Result")


class AppState:
    """The parts of a server. Store, workers and sessions exist while the application runs.

    Args:
        settings: The settings.
        clock: Returns seconds on a clock that nobody sets, for idle times; None for that of the machine.
    """

    store: Store
    workers: Workers
    sessions: Sessions

    def __init__(self, settings: Settings, clock: Callable[[], float] | None = None) -> None:
        self.settings = settings
        self.clock = clock or time.monotonic
        self.requests = RequestLog()
        self.networks = Networks(settings.weights, settings.data)
        self.results: dict[tuple[Path, str], tuple[object, Entries]] = {}
        """The entries of a folder for a task, with the identity of its files."""
        self.maps = DrawnMaps(settings.data / MAPS)

    async def work(
        self, request: Request, function: Callable[..., Result], *arguments: object, task: str | None = None
    ) -> Result:
        """Run a function in a worker process. The job is dropped if the client disconnects.

        Args:
            request: The request; clients take turns by address.
            function: A function of a module.
            arguments: Its arguments, which are pickled.
            task: The task that bounds the cost; None if the client's input does.

        Raises:
            RequestError: if too many requests are waiting, or the client has disconnected.
            TooLargeError: if the job takes too much time or memory.
            DroneEnvError: as the function.
        """
        job = asyncio.wrap_future(self.workers.submit(function, *arguments, caller=caller_address(request), task=task))
        left = asyncio.create_task(_disconnected(request))
        try:
            await asyncio.wait((job, left), return_when=asyncio.FIRST_COMPLETED)
            if not job.done():
                raise RequestError(503, "dropped", "the caller has left")
            return await job
        finally:
            left.cancel()
            job.cancel()

    async def write(self, function: Callable[..., Result], *arguments: object) -> Result:
        """Call a function that writes to the store, in a thread if it has to wait for another writer.

        A change of threads takes as much time as a step of an episode.
        """
        call = partial(function, *arguments)
        try:
            return self.store.database.at_once(call)
        except BusyError:
            return await asyncio.get_running_loop().run_in_executor(self._waiting, call)

    async def json(
        self, request: Request, function: Callable[..., str], *arguments: object, task: str | None = None
    ) -> Response:
        """Respond with the JSON that a function returns in a worker process. Arguments and errors as `work`."""
        content = await self.work(request, function, *arguments, task=task)
        return Response(content, media_type="application/json")

    def open(self) -> None:
        """Open the store and start the workers.

        Raises:
            OSError: if the data folder cannot be opened.
        """
        self.workers = Workers(self.settings)
        self.store = Store(self.settings.data, submit=self.workers.solve)
        # One thread is enough, because the store has one writer.
        self._waiting = ThreadPoolExecutor(1, "drone_env-steps")
        self.sessions = Sessions(self.store, self.settings.capacity, self.settings.idle_seconds, self.clock)
        # The clock may have begun anew with the machine.
        self.sessions.touch()
        TASK_FINDERS.append(self.maps.find)

    def close(self) -> None:
        """Close the store, and drop all jobs."""
        self._waiting.shutdown()
        TASK_FINDERS.remove(self.maps.find)
        self.store.close()
        self.workers.close()


def caller_address(connection: HTTPConnection) -> str:
    """Return the address of a client, the unit of fair shares; "" if it is unknown."""
    return "" if connection.client is None else connection.client.host


async def _disconnected(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


LONGEST_ID = 200
"""Maximum length of a session id."""


async def get_app_state(request: Request) -> AppState:
    """The parts of the server that handles a request."""
    return request.app.state.shared


AppStateDep = Annotated[AppState, Depends(get_app_state)]
