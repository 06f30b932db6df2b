"""HTTP sessions: rows of the store, and the live episodes of those that this process has flown.

The row is the truth: another process may have stepped the session, so each use brings the live episode up to the
row's actions first.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress

from drone_env.core.episode import Episode
from drone_env.errors import CapacityError, EpisodeError, NoSessionError, SessionGoneError
from drone_env.models import DroneAction
from drone_env.results.sessions import SessionRow, flight_of
from drone_env.results.store import Store
from drone_env.server.map_choice import start_episode
from drone_env.server.observation_json import flat_json
from drone_env.server.schemas import ResetOptions

ANONYMOUS = "anonymous"
"""The agent's name where none is given."""


Show = Callable[[Episode, float | None], str]
"""The JSON of an episode and of what its last step paid: `flat_json` or `openenv_json`."""


class _Live:
    """The episode of a session in this process; its lock is held by its user."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.episode: Episode | None = None

    def caught_up(self, row: SessionRow) -> Episode:
        """The episode with all actions of the row flown."""
        episode = self.episode
        if episode is None or not row.follows(episode):
            episode = self.episode = row.fly()
        for action in row.actions[episode.steps :]:
            episode.step(action)
        return episode


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
        self, session: str | None, options: ResetOptions, address: str | None = None, show: Show = flat_json
    ) -> tuple[str, str]:
        """Start an episode in the session, or in a new one where none is named or it is gone.

        Args:
            session: The session that the caller names, None for none.
            options: What to fly.
            address: Of a caller who names none and shares a session with others there who name none. It is used again
                once it has been flown so. One that has not may be that of a caller who will name it.
            show: Makes the answer from the episode.

        Returns:
            The session, and the first observation as JSON.

        Raises:
            UnknownNameError: if there is no such task, profile or split.
            InvalidValueError: if the split has no such map.
            CapacityError: if a new session is needed and there is no room.
        """
        if address is not None:
            session = self.store.unnamed_session(address)
        if session is not None:
            # Where it is gone the caller does what the error would ask for: open a new one.
            with suppress(NoSessionError, SessionGoneError):
                return session, self._reset_row(session, options, show, address, flown=address is not None)
        episode = start_episode(options, None)
        wanted = *flight_of(episode), options.agent or ANONYMOUS, self.capacity, address
        try:
            opened = self.store.open_session(*wanted)
        except CapacityError:
            if self.expire():
                opened = self.store.open_session(*wanted)
            elif session is not None and address is not None:
                return session, self._reset_row(session, options, show, address)
            else:
                raise
        first = show(episode, None)
        live = self._entry(opened)
        with live.lock:
            live.episode = episode
        return opened, first

    def _reset_row(
        self, session: str, options: ResetOptions, show: Show, address: str | None = None, flown: bool = False
    ) -> str:
        with self._held(session) as live:
            with self._changing(live, session, address) as row:
                if flown and not row.actions:
                    raise NoSessionError("nobody has flown this session yet")
                episode = live.episode = start_episode(options, row.seed)
                row.reset(*flight_of(episode), options.agent)
            return show(episode, None)

    def step(
        self,
        session: str,
        action: DroneAction,
        after: int | None = None,
        address: str | None = None,
        show: Show = flat_json,
    ) -> str:
        """Fly one action. What it returns is kept: the step, and the finished episode if it was the last.

        Args:
            session: The session.
            action: The action.
            after: How many steps the sender knows of. The step that comes after these is flown once, however often it
                is sent, and the same is returned each time; None flies it in any case.
            address: Of a caller who does not name the session.
            show: Makes the answer from the episode.

        Returns:
            The observation after the step as JSON, put together when others may write to the store again.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired.
            EpisodeError: if the session stands at another step than `after`, and not because of this action.
        """
        with self._held(session) as live:
            with self._changing(live, session, address) as row:
                episode = live.caught_up(row)
                flown = len(row.actions)
                if after is None or after == flown:
                    reward = row.step(episode, action.action)
                elif after == flown - 1 and row.actions[-1] == action.action:
                    # Flown again: a step after the end may have been sent meanwhile, and the answer must not show it.
                    episode = row.fly()
                    reward = episode.reward_last
                else:
                    raise EpisodeError(
                        f"this action is to follow step {after}, and the session has flown {flown} steps: GET /state "
                        "tells where it stands"
                    )
            return show(episode, reward)

    @contextmanager
    def reading(self, session: str) -> Generator[tuple[SessionRow, Episode], None, None]:
        """The row and the episode of a session, to be read inside the block.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired.
        """
        with self._held(session) as live:
            row = self.store.read_session(session)
            yield row, live.caught_up(row)

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
        """The live episode of a session, which nobody else uses meanwhile; forgotten where the session is gone."""
        live = self._entry(session)
        try:
            with live.lock:
                yield live
        except (NoSessionError, SessionGoneError):
            self._forget(session)
            raise

    @contextmanager
    def _changing(self, live: _Live, session: str, address: str | None) -> Generator[SessionRow, None, None]:
        """The row of a session that is held, to be changed; kept when the block ends."""
        try:
            with self.store.session(session, address) as row:
                yield row
        except BaseException:
            # Nothing was kept, so what was flown inside is not so.
            live.episode = None
            raise

    def _entry(self, session: str) -> _Live:
        with self._lock:
            live = self._live.setdefault(session, _Live())
            self._live.move_to_end(session)
            while len(self._live) > self.capacity:
                self._live.popitem(last=False)
            return live

    def _forget(self, session: str) -> None:
        with self._lock:
            self._live.pop(session, None)
