"""Sessions: each is one flight that goes on, in memory and as a row of the store.

A step is flown in place, under the lock of its session, and appended to the row. If another process has flown
meanwhile, the row has another revision: the flight is flown again from its row, and the step from there.
"""

import secrets
import sqlite3
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import SupportsIndex, TypeVar

from drone_env.core.episode import Episode
from drone_env.errors import CapacityError, EpisodeError, NoSessionError
from drone_env.flights.flight import (
    MapKey,
    digits_of,
    finish_flight,
    insert_flight,
    new_id,
    read_flight,
    read_provenance,
)
from drone_env.flights.provenance import Provenance
from drone_env.flights.store import Store

ANONYMOUS = "anonymous"
"""Default name of an agent."""
FINISHED_SECONDS = 30.0
"""A finished session is not evicted for this long: its owner still needs the score."""
APPEND = "UPDATE flights SET actions = actions || ?, revision = revision + 1 WHERE id = ? AND revision = ?"
IS_CURRENT = "SELECT 1 FROM flights WHERE id = ? AND revision = ?"
CHANGE = """
    UPDATE flights SET actions = substr(actions, 1, ?), values_used = ?, undo_used = ?, agent = ?
    WHERE id = ? AND revision = ?
"""
TOUCH = """
    UPDATE sessions SET touched_at = :now, address = :address{} WHERE id = :id AND flight_id = :stored_id
        AND (:address IS NULL OR address = :address)
"""
STAY, MOVE = TOUCH.format(""), TOUCH.format(", flight_id = :flight_id")
"""Touch a session of this flight, and give it another flight."""
SELECT_SESSION = """
    SELECT flight_id, revision, address FROM sessions JOIN flights ON flights.id = flight_id WHERE sessions.id = ?
"""
COUNT = "SELECT count(*), count(owner = :owner OR NULL) FROM sessions"
END = "DELETE FROM sessions WHERE id = ?"
EVICTABLE = """
    SELECT sessions.id FROM sessions JOIN flights ON flights.id = flight_id
    WHERE (actions = '' OR number IS NOT NULL AND touched_at <= :finished) AND (:all OR owner = :owner)
    ORDER BY actions != '', touched_at
"""
Result = TypeVar("Result")


@dataclass
class Session:
    """A caller's place on the server, with the episode in memory.

    Attributes:
        id: The secret id. Empty for the session of a connection, which has no row.
        flight_id: The id of its flight.
        episode: The episode after all actions.
        provenance: Who flies.
        address: The address whose callers share it without naming it; None after somebody has named it.
        revision: Counts the changes of the flight's row.
        stored_id: The id of the flight in the session's row; another one if this flight has just begun.
        unstored: The actions that the row does not contain, as digits.
        has_ended: Whether the flight has ended with the last of them.
        changed: Whether the row is wrong in more than that.
    """

    id: str
    flight_id: str
    episode: Episode
    provenance: Provenance
    address: str | None = None
    revision: int = 0
    stored_id: str = ""
    unstored: str = field(default="", repr=False)
    has_ended: bool = False
    changed: bool = False

    @property
    def episode_id(self) -> str | None:
        """The id of the finished flight in the store; None before the end."""
        return self.flight_id if self.episode.ended else None

    @property
    def is_stored(self) -> bool:
        """Whether the row of the flight contains all of it."""
        return not self.unstored and not self.changed and self.flight_id == self.stored_id

    def begin(self, episode: Episode, agent: str | Provenance | None = None) -> None:
        """Start another flight. An unfinished one is dropped.

        Args:
            episode: The episode, at its start.
            agent: The new pilot; None for the present one.

        Raises:
            InvalidValueError: if the agent's name is not one printable line.
        """
        if agent is not None:
            self.provenance = Provenance.of(agent)
        self.flight_id, self.episode, self.revision = new_id(), episode, 0
        self.unstored, self.has_ended, self.changed = "", False, False

    def fly(self, action: SupportsIndex, after: int | None = None) -> float:
        """Fly one action: the one step of HTTP, OpenEnv and the page. After the end nothing changes.

        Args:
            action: The action.
            after: The caller's step count. A repeated call with the same count is flown once and returns the same
                reward. None flies the action in any case.

        Returns:
            The reward.

        Raises:
            InvalidValueError: if it is not an action.
            EpisodeError: if the step count differs from `after`, and the last action is not this one.
        """
        flown = self.episode.steps
        if after is None or after == flown:
            reward = self.episode.step(action)
            if self.episode.steps > flown:
                self.unstored += str(int(action))
                self.has_ended = self.episode.ended
            return reward
        if after != flown - 1 or self.episode.actions[-1] != action:
            detail = f"X-Step-Count is {after}, but the session has flown {flown} steps: see GET /state"
            raise EpisodeError(detail)
        if self.episode.ended:
            # A step after the end may have changed the message.
            self._fly_again(self.episode.actions)
        return self.episode.reward_last

    def undo(self) -> None:
        """Take back the last step."""
        self._fly_again(self.episode.actions[:-1])
        self.provenance = self.provenance.model_copy(update={"undo_used": True})
        self.changed = True

    def use_values(self) -> None:
        """Note that a person has turned on values."""
        self.provenance = self.provenance.model_copy(update={"values_used": True})
        self.changed = True

    def _fly_again(self, actions: Sequence[int]) -> None:
        self.episode = Episode(self.episode.task, self.episode.reward_profile, self.episode.seed).fly(actions)


@dataclass
class _Place:
    lock: threading.Lock = field(default_factory=threading.Lock)
    session: Session | None = None
    """None if it must be flown again from its row."""


class Sessions:
    """The sessions of a store. Threads and processes may share it.

    Args:
        store: The store.
        capacity: Maximum number of open sessions of all processes together.
        idle_seconds: Idle time after which a session ends.
        clock: Returns seconds on a clock that all processes share, and that nobody sets.
    """

    def __init__(
        self, store: Store, capacity: int, idle_seconds: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.capacity = capacity
        self.idle_seconds = idle_seconds
        self._store = store
        self._database = store.database
        self._clock = clock
        self._places: OrderedDict[str, _Place] = OrderedDict()
        self._lock = threading.Lock()

    def open(
        self,
        episode: Episode,
        agent: str | Provenance,
        address: str | None = None,
        owner: str = "",
        keep: Collection[str] = (),
        flight_id: str | None = None,
    ) -> str:
        """Open a session that goes on with a flight and return its secret id.

        If there is no room, idle sessions end, or else the session without steps that was idle longest, or else the
        finished one that was idle longest, and for at least 30 s. An owner with sessions evicts only its own.

        Args:
            episode: The episode.
            agent: Who flies.
            address: The address whose callers share it without naming it (`unnamed`).
            owner: The address that opens it, which has a share of the sessions (`in_share`); empty if it is unknown.
            keep: Sessions that are not evicted.
            flight_id: The id of the flight; None for a new one.

        Raises:
            CapacityError: if all sessions are taken, or the owner has its share.
            InvalidValueError: if the agent's name is not one printable line.
            StoreError: if it could not be written.
        """
        session_id, flight_id = secrets.token_urlsafe(24), flight_id or new_id()
        provenance = Provenance.of(agent)
        with self._database.writing() as connection:
            self._database.check_task(connection, episode.task, claim=True)
            has_room = self._has_room(connection, owner)
            if not has_room and not (self._end_idle(connection) and self._has_room(connection, owner)):
                self._evict(connection, owner, keep)
            insert_flight(connection, flight_id, MapKey.of(episode), digits_of(episode.actions), provenance)
            if episode.ended:
                finish_flight(connection, flight_id, episode)
            # An address has at most one unnamed session.
            connection.execute("UPDATE sessions SET address = NULL WHERE address = ?", (address,))
            row = (session_id, flight_id, self._clock(), address, owner)
            connection.execute("INSERT INTO sessions VALUES (?, ?, ?, ?, ?)", row)
        session = Session(session_id, flight_id, episode.copy(), provenance, address, stored_id=flight_id)
        self._place(session_id).session = session
        self._trim()
        if episode.ended:
            self._store.on_finished([flight_id])
        return session_id

    def reset(
        self,
        session_id: str | None,
        start: Callable[[int | None], Episode],
        agent: str | Provenance | None,
        address: str | None = None,
        owner: str = "",
    ) -> tuple[str, Episode]:
        """Start an episode in a session, or in a new one if there is none.

        Args:
            session_id: The session; None for a new one.
            start: Returns the episode at its start, from the number of the session's last map; None in a new session.
            agent: Who flies; None keeps the present pilot; a new session has an anonymous one.
            address: The address of a caller without an id, who shares the session of the address. A shared session
                without steps is not reused unless there is no room, because who opened it may still use its id.
            owner: As `open`.

        Returns:
            The session, and the episode at its start.

        Raises:
            CapacityError: as `open`.
            DroneEnvError: as `start`.
        """
        if address is not None:
            session_id = self.unnamed(address)

        def restart(session: Session) -> Episode:
            if must_be_flown and not session.episode.steps:
                raise NoSessionError("this session has no steps yet")
            session.begin(start(session.episode.seed), agent)
            return session.episode.copy()

        must_be_flown = address is not None
        if session_id is not None:
            # If the session is gone, open a new one.
            with suppress(NoSessionError):
                return session_id, self.use(session_id, restart, address)
        episode = start(None)
        try:
            return self.open(episode, agent or ANONYMOUS, address, owner), episode
        except CapacityError:
            if session_id is None or address is None:
                raise
            must_be_flown = False
            return session_id, self.use(session_id, restart, address)

    def use(self, session_id: str, change: Callable[[Session], Result], address: str | None = None) -> Result:
        """Call a function that may change a session, store the changes in one transaction, and return its result.

        If another process has changed the session, the function is called again with its present state; it must have
        no other effects. If it raises, nothing is changed. A call counts as use.

        Args:
            session_id: The session.
            change: The function.
            address: The address of a caller that does not name the session. A caller that names it makes it private.

        Raises:
            NoSessionError: if there is no such session, or somebody has named that of the address.
            StoreError: if the store stays busy for 30 s or cannot be written, or the function uses another session.
        """
        place = self._place(session_id)
        with place.lock:
            while True:
                session, is_fresh = place.session, place.session is None
                if session is None:
                    session = self._load(session_id)
                place.session = None
                try:
                    if address is not None and session.address != address:
                        raise NoSessionError("this session has been named meanwhile: send its id")
                    result = change(session)
                except Exception:
                    if session.is_stored:
                        place.session = session
                    if is_fresh or self._is_current(session):
                        raise
                    place.session = None
                    continue
                if self._save(session, address):
                    place.session = session
                    return result

    def step(
        self,
        session_id: str,
        action: int,
        answer: Callable[[Episode], Result],
        after: int | None = None,
        address: str | None = None,
    ) -> Result:
        """Fly one action and return what `answer` makes of the episode; the rest as `Session.fly` and `use`."""

        def fly(session: Session) -> Result:
            session.fly(action, after)
            return answer(session.episode)

        return self.use(session_id, fly, address)

    def read(self, session_id: str) -> Session:
        """Return a copy of a session, which does not change. This does not count as use.

        Raises:
            NoSessionError: if there is no such session.
            StoreError: if the store cannot be read.
        """
        place = self._place(session_id)
        with place.lock:
            if place.session is None or not self._is_current(place.session):
                place.session = None
                place.session = self._load(session_id)
            session = place.session
            return Session(session_id, session.flight_id, session.episode.copy(), session.provenance, session.address)

    def check(self, session_id: str) -> None:
        """Check that there is a session.

        Raises:
            NoSessionError: if there is none.
        """
        self._row(session_id)

    def unnamed(self, address: str) -> str | None:
        """Return the session that the callers of an address share; None if there is none, or somebody has named it.

        Raises:
            StoreError: if the store cannot be read.
        """
        with self._database.reading() as connection:
            found = connection.execute("SELECT id FROM sessions WHERE address = ?", (address,)).fetchone()
        return None if found is None else found[0]

    def end(self, session_id: str) -> None:
        """End a session. An unfinished flight is dropped.

        Raises:
            NoSessionError: if there is no such session.
            StoreError: if it could not be written.
        """
        self.check(session_id)
        with self._database.writing() as connection:
            connection.execute(END, (session_id,))

    def touch(self) -> None:
        """Count all sessions as used now.

        Raises:
            StoreError: if it could not be written.
        """
        with self._database.writing() as connection:
            connection.execute("UPDATE sessions SET touched_at = ?", (self._clock(),))

    def expire(self) -> int:
        """End the idle sessions and return their number.

        Raises:
            StoreError: if it could not be written.
        """
        self._database.probe()
        with self._database.writing() as connection:
            return self._end_idle(connection)

    def count(self) -> int:
        """Return the number of open sessions.

        Raises:
            StoreError: if the store cannot be read.
        """
        with self._database.reading() as connection:
            return connection.execute(COUNT, {"owner": ""}).fetchone()[0]

    def _place(self, session_id: str) -> _Place:
        with self._lock:
            place = self._places.setdefault(session_id, _Place())
            self._places.move_to_end(session_id)
            return place

    def _trim(self) -> None:
        """Drop the places that were used least recently."""
        with self._lock:
            while len(self._places) > self.capacity:
                self._places.popitem(last=False)

    def _row(self, session_id: str) -> sqlite3.Row:
        with self._database.reading() as connection:
            # Ids are ASCII, and SQLite rejects lone surrogates.
            row = connection.execute(SELECT_SESSION, (session_id if session_id.isascii() else "",)).fetchone()
        if row is None:
            self._places.pop(session_id, None)
            raise NoSessionError("there is no such session: it has ended, was idle for too long, or never was")
        return row

    def _is_current(self, session: Session) -> bool:
        """Return whether no other process has changed a session."""
        return tuple(self._row(session.id)) == (session.stored_id, session.revision, session.address)

    def _load(self, session_id: str) -> Session:
        """Fly the flight of a session again."""
        row = self._row(session_id)
        with self._database.reading() as connection:
            flight = read_flight(connection, row["flight_id"])
            provenance = read_provenance(connection, flight)
        episode = flight.fly()
        self._trim()
        return Session(session_id, flight.id, episode, provenance, row["address"], row["revision"], flight.id)

    def _save(self, session: Session, address: str | None) -> bool:
        """Store the changes of a session; False if another process has changed it."""
        begins, is_stored = session.flight_id != session.stored_id, session.is_stored
        ids = {"id": session.id, "flight_id": session.flight_id, "stored_id": session.stored_id}
        with self._database.writing() as connection:
            values = {**ids, "now": self._clock(), "address": address}
            if not connection.execute(MOVE if begins else STAY, values).rowcount:
                return False
            if begins:
                key = MapKey.of(session.episode)
                self._database.check_task(connection, session.episode.task, claim=True)
                insert_flight(connection, session.flight_id, key, session.unstored, session.provenance)
            elif is_stored:
                if connection.execute(IS_CURRENT, (session.flight_id, session.revision)).fetchone() is None:
                    return False
            else:
                row = (session.flight_id, session.revision)
                if session.changed:
                    stored, by = session.episode.steps - len(session.unstored), session.provenance
                    connection.execute(CHANGE, (stored, by.values_used, by.undo_used, by.label, *row))
                if not connection.execute(APPEND, (session.unstored, *row)).rowcount:
                    return False
                session.revision += 1
            if session.has_ended:
                finish_flight(connection, session.flight_id, session.episode)
        session.stored_id, session.address = session.flight_id, address
        session.unstored, session.changed = "", False
        if session.has_ended:
            session.has_ended = False
            self._store.on_finished([session.flight_id])
        return True

    def _has_room(self, connection: sqlite3.Connection, owner: str) -> bool:
        taken, own = connection.execute(COUNT, {"owner": owner}).fetchone()
        return in_share(own if owner else 0, taken, self.capacity)

    def _evict(self, connection: sqlite3.Connection, owner: str, keep: Collection[str]) -> None:
        """End the session that is needed least.

        Raises:
            CapacityError: if all are needed.
        """
        taken, own = connection.execute(COUNT, {"owner": owner}).fetchone()
        values = {"finished": self._clock() - FINISHED_SECONDS, "all": not (owner and own), "owner": owner}
        evictable = [row["id"] for row in connection.execute(EVICTABLE, values) if row["id"] not in keep]
        if not evictable and taken < self.capacity:
            share = f"this address has {own} of {self.capacity} sessions, its share: end one"
            raise CapacityError(f"{share}, or raise DRONE_ENV_CAPACITY")
        if not evictable:
            raise CapacityError(f"all {self.capacity} sessions are taken: try again later")
        connection.execute(END, evictable[:1])

    def _end_idle(self, connection: sqlite3.Connection) -> int:
        limit = self._clock() - self.idle_seconds
        return connection.execute("DELETE FROM sessions WHERE touched_at <= ?", (limit,)).rowcount


def in_share(own: int, taken: int, capacity: int) -> bool:
    """Return whether an address may take one more of `capacity` places: it holds fewer than are free.

    One address thus takes at most half of the places, two take a third each, and a newcomer finds one free.

    Args:
        own: The places that the address holds.
        taken: The places that all addresses hold.
        capacity: The number of places.
    """
    return own < capacity - taken
