"""HTTP sessions: which one a request flies, their rows in the store, and a cache of their episodes in memory.

Another process may have stepped a session, so each use first flies the actions of the row on from a copy of the cached
episode. Cached sessions are never changed, so that threads may read them without a lock.
"""

import threading
from collections import OrderedDict
from collections.abc import Collection, Generator
from contextlib import contextmanager, suppress
from typing import NamedTuple

from fastapi import Request, Response
from typing_extensions import Self

from drone_env.core.episode import Episode
from drone_env.errors import CapacityError, EpisodeError, NoSessionError
from drone_env.results.sessions import Session, advance
from drone_env.results.store import Store
from drone_env.server.addresses import shared_address
from drone_env.server.exceptions import WHAT_TO_DO, RequestError
from drone_env.server.map_choice import start_episode
from drone_env.server.schemas import ResetOptions

COOKIE = "drone_env_session"
HEADER = "X-Session-Id"
NEW = "new"
"""As `X-Session-Id` of a reset, this opens a private session."""
LONGEST_ID = 200
ANONYMOUS = "anonymous"
"""Default name of an agent."""


class Caller(NamedTuple):
    """The session id of a request, or the `address` whose callers share a session."""

    named: str | None
    address: str | None

    @classmethod
    def of(cls, request: Request) -> Self:
        """Read the header or the cookie. Empty ones count as missing."""
        named = request.headers.get(HEADER) or request.cookies.get(COOKIE)
        if named or request.app.state.shared.settings.token is not None:
            return cls(None if named in ("", NEW) else named, None)
        return cls(None, shared_address(request.scope))

    def session(self, sessions: "Sessions", answer: Response | None = None) -> str:
        """Return the session id. The header of `answer` contains the id of a shared session.

        Raises:
            RequestError: if there is no session.
        """
        if self.named is not None:
            return self.named
        session = None if self.address is None else sessions.store.unnamed_session(self.address)
        if session is None:
            raise RequestError(409, "no_session", f"this request names no session: {WHAT_TO_DO}")
        if answer is not None:
            answer.headers[HEADER] = session
        return session


class Sessions:
    """The HTTP sessions of a store. Thread-safe.

    Args:
        store: The store.
        capacity: Most open sessions of all processes together.
        idle_seconds: Idle time after which a session ends.
    """

    def __init__(self, store: Store, capacity: int, idle_seconds: float) -> None:
        self.store = store
        self.capacity = capacity
        self.idle_seconds = idle_seconds
        self._cache: OrderedDict[str, Session] = OrderedDict()
        self._lock = threading.Lock()

    def reset(
        self,
        session: str | None,
        options: ResetOptions,
        address: str | None = None,
        owner: str = "",
        keep: Collection[str] = (),
    ) -> tuple[str, Episode]:
        """Start an episode in the session, or in a new one if there is none.

        Args:
            session: The session id of the request, or None.
            options: The body of the request.
            address: The address of a caller without an id, who shares the session of the address. A shared session
                without steps is not reused, because the caller who opened it may still use its id.
            owner: The address of the caller; each address has a share of the sessions.
            keep: Sessions that are not evicted.

        Returns:
            The session id, and the episode at its start.

        Raises:
            UnknownNameError: if there is no such task, profile or split.
            InvalidValueError: if the split has no such map.
            CapacityError: if a new session is needed and there is no room.
        """
        if address is not None:
            session = self.store.unnamed_session(address)
        if session is not None:
            # If the session is gone, open a new one.
            with suppress(NoSessionError):
                return session, self._begin(session, options, address, flown=address is not None)
        episode = start_episode(options, None)
        arguments = episode, options.agent or ANONYMOUS, self.capacity, address, owner, keep
        try:
            opened = self.store.open_session(*arguments)
        except CapacityError:
            if self.expire():
                opened = self.store.open_session(*arguments)
            elif session is not None and address is not None:
                return session, self._begin(session, options, address)
            else:
                raise
        return opened, episode

    def _begin(self, session: str, options: ResetOptions, address: str | None, flown: bool = False) -> Episode:
        with self.changing(session, address) as row:
            if flown and not row.actions:
                raise NoSessionError("this session has no steps yet")
            episode = start_episode(options, row.seed)
            row.begin(episode, options.agent)
            return episode

    def advance(
        self, session: str, action: int, after: int | None = None, address: str | None = None
    ) -> tuple[Episode, float]:
        """Fly one action, and store the step, and the episode if it ends.

        Args:
            session: The session id.
            action: The action.
            after: The caller's step count. A repeated request with the same count is flown once and returns the same
                result. None flies the action in any case.
            address: The address of a caller without an id.

        Returns:
            The episode, and the reward.

        Raises:
            NoSessionError: if there is no such session.
            EpisodeError: if its step count differs from `after`, and the last action is not this one.
        """
        with self.changing(session, address) as row:
            flown = len(row.actions)
            if after is None or after == flown:
                reward = advance(row, action)
            elif after == flown - 1 and row.actions[-1] == action:
                # Replay the row: a step after the end may have changed the episode in memory.
                row.episode = None
                reward = row.fly().reward_last
            else:
                detail = f"X-Step-Count is {after}, but the session has flown {flown} steps: see GET /state"
                raise EpisodeError(detail)
            return row.fly(), reward

    @contextmanager
    def changing(self, session: str, address: str | None = None) -> Generator[Session, None, None]:
        """Context manager of a session to change; stored at the end of the block, and not changed from then on.

        Raises:
            NoSessionError: if there is no such session.
        """
        with self.store.session(session, address) as row:
            row.go_on_from(self._cache.get(session))
            yield row
        self._keep(row)

    def read(self, session: str) -> Session:
        """Return a session to read; its episode is in memory.

        Raises:
            NoSessionError: if there is no such session.
        """
        row = self.store.read_session(session)
        row.go_on_from(self._cache.get(session))
        row.fly()
        self._keep(row)
        return row

    def expire(self) -> int:
        """End idle sessions, and return their number."""
        return self.store.expire_sessions(self.idle_seconds)

    def _keep(self, row: Session) -> None:
        """Cache a session instead of the one that was used least recently."""
        with self._lock:
            self._cache[row.id] = row
            self._cache.move_to_end(row.id)
            while len(self._cache) > self.capacity:
                self._cache.popitem(last=False)
