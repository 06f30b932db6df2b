"""What the routes share: one `Shared` per application, found at `app.state.shared`."""

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated, NamedTuple, TypeVar

from fastapi import Depends, Header, Request, Response
from starlette.requests import HTTPConnection
from typing_extensions import Self

from drone_env.core.tasks import FINDERS
from drone_env.files import MAPS
from drone_env.results.store import Store
from drone_env.server.drawn_maps import DrawnMaps
from drone_env.server.logs import RequestLog
from drone_env.server.model_runs import StoredRuns
from drone_env.server.predict import Networks
from drone_env.server.problems import WHAT_TO_DO, RequestError, answers
from drone_env.server.security import shared_address
from drone_env.server.sessions import Sessions
from drone_env.server.settings import Settings
from drone_env.server.workers import Workers

COOKIE = "drone_env_session"
HEADER = "X-Session-Id"
SHARED_HEADER = "X-Session-Shared"
NEW = "new"
"""Named as a session it stands for none: a caller that sends it with a reset shares with nobody."""
LONGEST_ID = 200
SESSION_ERRORS = answers(409, 410, 422, 503)
Result = TypeVar("Result")


class Shared:
    """The parts of a server; store and sessions are there while it runs.

    Args:
        settings: The configuration.
        clock: Gives the time, in seconds since 1970; None for the store's own.
    """

    store: Store
    workers: Workers
    steps: ThreadPoolExecutor
    """Flies the steps of HTTP sessions. One thread: the store has one writer anyway."""

    def __init__(self, settings: Settings, clock: Callable[[], float] | None = None) -> None:
        self.settings = settings
        self._clock = clock
        self.requests = RequestLog()
        self.networks = Networks(settings.weights, settings.data)
        self.runs = StoredRuns(settings.data)
        self.maps = DrawnMaps(settings.data / MAPS, settings.maps)
        self._sessions: Sessions | None = None

    async def work(
        self, request: Request, function: Callable[..., Result], *arguments: object, task: str | None = None
    ) -> Result:
        """Have a worker process call a function of a module, as long as the caller of a request waits for it.

        Args:
            request: The request. Callers take turns by address.
            function: What to call.
            arguments: Its arguments, which are pickled.
            task: The task that bounds it, None if what a visitor sent does.

        Raises:
            RequestError: if too many requests are waiting, or the caller has left.
            TooLargeError: if it takes too much time or memory.
            DroneEnvError: what the function raises.
        """
        job = asyncio.ensure_future(self.workers.run(function, *arguments, caller=caller_address(request), task=task))
        left = asyncio.create_task(_left(request))
        try:
            await asyncio.wait((job, left), return_when=asyncio.FIRST_COMPLETED)
            if not job.done():
                raise RequestError(503, "dropped", "the caller has left")
            return await job
        finally:
            left.cancel()
            job.cancel()

    async def json(
        self, request: Request, function: Callable[..., str], *arguments: object, task: str | None = None
    ) -> Response:
        """The answer with the JSON that a worker process makes. Arguments and errors as `work`."""
        made = await self.work(request, function, *arguments, task=task)
        return Response(made, media_type="application/json")

    @property
    def sessions(self) -> Sessions:
        """The HTTP sessions.

        Raises:
            RequestError: if the server has not started, or has ended.
        """
        if self._sessions is None:
            message = "the server is not running: a test client starts it in a block, `with TestClient(app) as client:`"
            raise RequestError(503, "not_started", message)
        return self._sessions

    def open(self) -> None:
        """Open what is kept in the data folder.

        Raises:
            OSError: if it cannot be opened.
        """
        self.workers = Workers(self.settings)
        self.store = Store(self.settings.data, self._clock, submit=self.workers.solve)
        self.steps = ThreadPoolExecutor(1, "drone_env-steps")
        self._sessions = Sessions(self.store, self.settings.capacity, self.settings.idle_seconds)
        FINDERS.append(self.maps.find)

    def close(self) -> None:
        """Close it, and drop all long work."""
        if self._sessions is not None:
            self._sessions = None
            self.steps.shutdown()
            FINDERS.remove(self.maps.find)
            self.store.close()
            self.workers.close()


def caller_address(connection: HTTPConnection) -> str:
    """The address of a caller, as `Workers` counts them; empty where the server does not tell it."""
    return "" if connection.client is None else connection.client.host


async def _left(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


async def shared_of(request: Request) -> Shared:
    """The parts of the server that answers a request."""
    return request.app.state.shared


class Caller(NamedTuple):
    """The session that a request `named`, or the `address` whose callers share one."""

    named: str | None
    address: str | None

    @classmethod
    def of(cls, request: Request) -> Self:
        """Who sends a request; an empty header or cookie names no session."""
        named = request.headers.get(HEADER) or request.cookies.get(COOKIE)
        if named or request.app.state.shared.settings.token is not None:
            return cls(None if named in ("", NEW) else named, None)
        return cls(None, shared_address(request.scope))

    def session(self, shared: Shared, answer: Response | None = None) -> str:
        """The session that is meant; where it is shared, the answer says so.

        Raises:
            RequestError: if there is none.
        """
        if self.named is not None:
            return self.named
        session = None if self.address is None else shared.store.unnamed_session(self.address)
        if session is None:
            raise RequestError(409, "no_session", f"this request names no session: {WHAT_TO_DO}")
        if answer is not None:
            self.tell(session, answer)
        return session

    def tell(self, session: str, answer: Response) -> None:
        """Have an answer name the session, and say where it is shared."""
        answer.headers[HEADER] = session
        if self.address is not None:
            answer.headers[SHARED_HEADER] = self.address


async def caller_of(
    request: Request,
    _: Annotated[
        str | None,
        Header(
            alias=HEADER,
            max_length=LONGEST_ID,
            description="The session, as `/reset` gave it; goes before the cookie. With `new` a reset opens one.",
        ),
    ] = None,
) -> Caller:
    """Who sends a request."""
    return Caller.of(request)


SharedParts = Annotated[Shared, Depends(shared_of)]
CallerOf = Annotated[Caller, Depends(caller_of)]
