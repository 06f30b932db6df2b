"""What the routes share: one `Shared` per application, found at `app.state.shared`."""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Annotated, NamedTuple, TypeVar

import anyio.to_thread
from fastapi import Depends, Header, Request, Response
from typing_extensions import Self

from drone_env.core.tasks import FINDERS, TaskConfig
from drone_env.episodes.store import Store
from drone_env.files import EVALUATIONS, MAPS, RUNS
from drone_env.planning.optimal import best_of
from drone_env.server.drawn_maps import DrawnMaps
from drone_env.server.evaluations import Evaluations
from drone_env.server.exact_values import ExactValues
from drone_env.server.local import shared_address
from drone_env.server.map_values import MapValues
from drone_env.server.model_runs import ModelRuns
from drone_env.server.predict import Networks
from drone_env.server.problems import WHAT_TO_DO, RequestError, answers
from drone_env.server.request_log import RequestLog
from drone_env.server.sessions import Sessions
from drone_env.server.settings import Settings

COOKIE = "drone_env_session"
HEADER = "X-Session-Id"
SHARED_HEADER = "X-Session-Shared"
NEW = "new"
"""Named as a session it stands for none: a caller that sends it with a reset shares with nobody."""
LONGEST_ID = 200
SESSION_ERRORS = answers(409, 410, 422, 503)
STUDIES = max(1, (os.cpu_count() or 1) // 2)
"""Studies at once: the other cores are for those who fly."""
WAITING_STUDIES = 16
"""Studies that may wait, each of which may take a second."""
Found = TypeVar("Found")


class Shared:
    """The parts of a server; store and sessions are there while it runs.

    Args:
        settings: The configuration.
        clock: Gives the time, in seconds since 1970; None for the store's own.
    """

    def __init__(self, settings: Settings, clock: Callable[[], float] | None = None) -> None:
        self.settings = settings
        self._clock = clock
        self.requests = RequestLog()
        self.networks = Networks(settings.weights, settings.data)
        self.values = ExactValues()
        self.map_values = MapValues(self.values, self.networks)
        self.runs = ModelRuns(settings.data / RUNS)
        self.evaluations = Evaluations(settings.data / EVALUATIONS)
        self.maps = DrawnMaps(settings.data / MAPS, settings.maps)
        self._sessions: Sessions | None = None
        self.steps: ThreadPoolExecutor | None = None
        """Flies the steps of HTTP sessions while the server runs. One thread: the store has one writer anyway."""
        self._studies: anyio.CapacityLimiter | None = None
        self._studying = 0

    async def study(self, work: Callable[[], Found]) -> Found:
        """Do what takes long in a thread that no other request needs, a few at a time.

        Raises:
            RequestError: if too many wait already.
        """
        if self._studies is None:  # made here, in the event loop that it belongs to
            self._studies = anyio.CapacityLimiter(STUDIES)
        # Counted here: a newcomer does not wait at the limiter yet.
        if self._studying >= STUDIES + WAITING_STUDIES:
            raise RequestError(503, "busy", f"{WAITING_STUDIES} flights are waiting to be looked at: try again later")
        self._studying += 1
        try:
            return await anyio.to_thread.run_sync(work, limiter=self._studies)
        finally:
            self._studying -= 1

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

    @property
    def store(self) -> Store:
        """The store.

        Raises:
            RequestError: if the server has not started, or has ended.
        """
        return self.sessions.store

    def open(self) -> None:
        """Open what is kept in the data folder.

        Raises:
            OSError: if it cannot be opened.
        """
        store = Store(self.settings.data, self._clock)
        self.steps = ThreadPoolExecutor(1, "drone_env-steps")
        self._sessions = Sessions(store, self.settings.capacity, self.settings.idle_seconds)
        FINDERS.append(self.maps.find)

    def close(self) -> None:
        """Close it; waits for the map that is being solved just now."""
        self.values.close()
        if self.steps is not None:
            self.steps.shutdown()
            self.steps = None
        if self._sessions is not None:
            FINDERS.remove(self.maps.find)
            self._sessions.store.close()
            self._sessions = None
        self._studies = None


@cache
def warm_up(task: TaskConfig) -> None:
    """Have what solves a task compiled in the background, once: nobody should wait for that at the end.

    Only tasks where terrain costs or blocks need that.
    """
    if not task.uniform:
        threading.Thread(target=best_of, args=(task, 0), name="drone_env-warm-up", daemon=True).start()


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

    def session(self, shared: Shared, answer: Response) -> str:
        """The session that is meant; where it is shared, the answer says so.

        Raises:
            RequestError: if there is none.
        """
        if self.named is not None:
            return self.named
        session = None if self.address is None else shared.store.unnamed_session(self.address)
        if session is None:
            raise RequestError(409, "no_session", f"this request names no session: {WHAT_TO_DO}")
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
