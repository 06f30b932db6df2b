"""HTTP sessions: rows of the store, and the episodes of those that this process has flown; and observations as JSON.

The row is the truth: another process may have stepped the session, so each use brings the episode in memory up to the
actions of the row first.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from typing import TypeVar

from drone_env.core.episode import Episode
from drone_env.errors import CapacityError, EpisodeError, NoSessionError, SessionGoneError
from drone_env.results.sessions import Session, advance
from drone_env.results.store import Store
from drone_env.server.map_choice import start_episode
from drone_env.server.schemas import ResetOptions

ANONYMOUS = "anonymous"
"""Name of an agent that gives none."""
Result = TypeVar("Result")
Show = Callable[[Episode, float | None], Result]
"""Makes the answer from an episode and the reward of its last step; for HTTP `flat_json` or `openenv_json`."""


class OtherStepError(EpisodeError):
    """The session has flown another number of steps than the caller knows of."""


class _Live:
    """A session in this process, as it was last used; its lock is held by its user."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.session: Session | None = None


class Sessions:
    """The HTTP sessions of a store; safe to share between threads.

    Args:
        store: Where they are kept.
        capacity: How many may be open, in all processes together.
        idle_seconds: How long one may be unused.
    """

    def __init__(self, store: Store, capacity: int, idle_seconds: float) -> None:
        self.store = store
        self.capacity = capacity
        self.idle_seconds = idle_seconds
        self._live: OrderedDict[str, _Live] = OrderedDict()
        self._lock = threading.Lock()

    def reset(
        self, session: str | None, options: ResetOptions, show: Show[Result], address: str | None = None
    ) -> tuple[str, Result]:
        """Start an episode in the session, or in a new one if none is named or it is gone.

        Args:
            session: The session that the caller names, None for none.
            options: What to fly.
            show: Makes the answer.
            address: Of a caller who names none and shares a session with others there who name none. It is used again
                once it has been flown so. One that has not may be that of a caller who will name it.

        Returns:
            The session, and what `show` returns.

        Raises:
            UnknownNameError: if there is no such task, profile or split.
            InvalidValueError: if the split has no such map.
            CapacityError: if a new session is needed and there is no room.
        """
        if address is not None:
            session = self.store.unnamed_session(address)
        if session is not None:
            # If it is gone, the caller does what the error would ask for: open a new one.
            with suppress(NoSessionError, SessionGoneError):
                return session, self._begin(session, options, show, address, flown=address is not None)
        episode = start_episode(options, None)
        wanted = episode, options.agent or ANONYMOUS, self.capacity, address
        try:
            opened = self.store.open_session(*wanted)
        except CapacityError:
            if self.expire():
                opened = self.store.open_session(*wanted)
            elif session is not None and address is not None:
                return session, self._begin(session, options, show, address)
            else:
                raise
        return opened, show(episode, None)

    def _begin(
        self, session: str, options: ResetOptions, show: Show[Result], address: str | None, flown: bool = False
    ) -> Result:
        with self._held(session) as live:
            with self._changing(live, session, address) as row:
                if flown and not row.actions:
                    raise NoSessionError("nobody has flown this session yet")
                episode = start_episode(options, row.seed)
                row.begin(episode, options.agent)
            return show(episode, None)

    def advance(
        self,
        session: str,
        action: int,
        show: Show[Result],
        after: int | None = None,
        address: str | None = None,
        check: Callable[[Session], None] | None = None,
    ) -> tuple[Session, Result]:
        """Fly one action, and keep the step and the finished episode if it was the last.

        Args:
            session: The session.
            action: The action.
            show: Makes the answer, when others may write to the store again.
            after: How many steps the sender knows of. The step that comes after these is flown once, however often it
                is sent, and the same is returned each time; None flies it in any case.
            address: Of a caller who does not name the session.
            check: Raises an error if the session is not to be stepped.

        Returns:
            The session, and what `show` returns.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired.
            OtherStepError: if it has flown another number of steps than `after`, and not because of this action.
        """
        with self._held(session) as live:
            with self._changing(live, session, address) as row:
                if check is not None:
                    check(row)
                flown = len(row.actions)
                if after is None or after == flown:
                    reward = advance(row, action)
                elif after == flown - 1 and row.actions[-1] == action:
                    # Flown again: a step after the end may have been sent meanwhile, and the answer must not show it.
                    row.episode = None
                    reward = row.fly().reward_last
                else:
                    raise OtherStepError(
                        f"this action is to follow step {after}, and the session has flown {flown} steps: GET /state "
                        "tells where it stands"
                    )
            return row, show(row.fly(), reward)

    @contextmanager
    def changing(self, session: str, address: str | None = None) -> Generator[Session, None, None]:
        """A session to be changed inside the block; kept when that ends.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired.
        """
        with self._held(session) as live, self._changing(live, session, address) as row:
            yield row

    @contextmanager
    def reading(self, session: str) -> Generator[Session, None, None]:
        """A session to be read inside the block; its episode is in memory.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired.
        """
        with self._held(session) as live:
            row = self.store.read_session(session)
            row.go_on_from(live.session)
            row.fly()
            live.session = row
            yield row

    def end(self, session: str) -> None:
        """End a session: it is gone, and its place free.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired already.
        """
        self._forget(session)
        self.store.end_session(session)

    def expire(self) -> list[str]:
        """End the sessions that were idle for too long, and return their ids."""
        gone = self.store.expire_sessions(self.idle_seconds)
        for session in gone:
            self._forget(session)
        return gone

    @contextmanager
    def _held(self, session: str) -> Generator[_Live, None, None]:
        """A session in this process, which nobody else uses meanwhile; forgotten if the session is gone."""
        with self._lock:
            live = self._live.setdefault(session, _Live())
            self._live.move_to_end(session)
            while len(self._live) > self.capacity:
                self._live.popitem(last=False)
        try:
            with live.lock:
                yield live
        except (NoSessionError, SessionGoneError):
            self._forget(session)
            raise

    @contextmanager
    def _changing(self, live: _Live, session: str, address: str | None) -> Generator[Session, None, None]:
        known, live.session = live.session, None  # if nothing is kept, what was flown inside is not so
        with self.store.session(session, address) as row:
            row.go_on_from(known)
            yield row
        live.session = row

    def _forget(self, session: str) -> None:
        with self._lock:
            self._live.pop(session, None)
