"""What the routes share: one `Shared` per application, found at `app.state.shared`."""

import threading
from collections.abc import Callable
from typing import Annotated

from fastapi import Cookie, Depends, Header, Request

from drone_env.core.tasks import TaskConfig, get_task
from drone_env.episodes.store import Store
from drone_env.planning.optimal import best_of
from drone_env.server.predict import Networks
from drone_env.server.problems import WHAT_TO_DO, RequestError
from drone_env.server.request_log import RequestLog
from drone_env.server.sessions import Sessions
from drone_env.server.settings import Settings

COOKIE = "drone_env_session"
HEADER = "X-Session-Id"
STEP_HEADER = "X-Step-Count"
LONGEST_ID = 200


class Shared:
    """The parts of a server; store and sessions are there while it runs.

    Args:
        settings: The configuration.
        clock: What tells the time, in seconds since 1970; None for the store's own.
    """

    def __init__(self, settings: Settings, clock: Callable[[], float] | None = None) -> None:
        self.settings = settings
        self._clock = clock
        self.requests = RequestLog()
        self.networks = Networks(settings.weights)
        self._sessions: Sessions | None = None
        self._warm: set[TaskConfig] = set()

    def warm_up(self, task: str | TaskConfig) -> None:
        """Have what solves a task compiled in the background, once: nobody should wait for that at the end.

        Only tasks where terrain costs or blocks need that.
        """
        known = get_task(task)
        if not known.uniform and known not in self._warm:
            self._warm.add(known)
            threading.Thread(target=best_of, args=(known, 0), name="drone_env-warm-up", daemon=True).start()

    @property
    def sessions(self) -> Sessions:
        """The HTTP sessions.

        Raises:
            RequestError: if the server has not started, or has ended.
        """
        if self._sessions is None:
            raise RequestError(503, "not_started", "the server is not running")
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
        self.requests.open(self.settings.data)
        self._sessions = Sessions(store, self.settings.capacity, self.settings.idle_seconds)

    def close(self) -> None:
        """Close it."""
        if self._sessions is not None:
            self._sessions.store.close()
            self._sessions = None
        self.requests.close()


async def shared_of(request: Request) -> Shared:
    """The parts of the server that answers a request."""
    return request.app.state.shared


async def named_session(
    x_session_id: Annotated[
        str | None,
        Header(max_length=LONGEST_ID, description="The session, as `/reset` gave it; goes before the cookie."),
    ] = None,
    drone_env_session: Annotated[str | None, Cookie(max_length=LONGEST_ID, include_in_schema=False)] = None,
) -> str | None:
    """The session that a request names, None for none; an empty header or cookie names none."""
    return x_session_id or drone_env_session or None


async def needed_session(named: Annotated[str | None, Depends(named_session)]) -> str:
    """The session that a request names.

    Raises:
        RequestError: if it names none.
    """
    if named is None:
        raise RequestError(409, "no_session", f"this request names no session: {WHAT_TO_DO}")
    return named


async def known_steps(
    x_step_count: Annotated[
        int | None,
        Header(
            ge=0,
            description="The `step_count` that this action follows: it is then flown once, however often it is sent.",
        ),
    ] = None,
) -> int | None:
    """How many steps of the episode the sender of an action knows of; None where it does not say."""
    return x_step_count


SharedParts = Annotated[Shared, Depends(shared_of)]
NamedSession = Annotated[str | None, Depends(named_session)]
SessionId = Annotated[str, Depends(needed_session)]
KnownSteps = Annotated[int | None, Depends(known_steps)]
