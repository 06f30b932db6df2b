"""Sessions: each is one flight that goes on, in memory and as a row of the store.

A step is flown in place and appended to the row in one transaction, which also keeps out other threads and processes.
If another process has flown meanwhile, the row has another revision: the flight is first flown again from its row.
"""

import secrets
import sqlite3
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import SupportsIndex, TypeVar

from drone_env.core.episode import Episode
from drone_env.errors import CapacityError, EpisodeError, NoSessionError
from drone_env.flights.database import VERSION
from drone_env.flights.flight import COLUMNS, Flight, finish_flight, insert_flight, new_id
from drone_env.flights.provenance import Provenance
from drone_env.flights.store import Store

ANONYMOUS = "anonymous"
"""Default name of an agent."""
SELECT_SESSION = f"""
    SELECT {COLUMNS}, revision, address FROM flights
    JOIN (SELECT flight_id, address FROM sessions WHERE id = ?) ON flights.id = flight_id
"""
FLY = "UPDATE flights SET actions = substr(actions, 1, ?) || ?, revision = revision + 1 WHERE id = ?"
USE_HELP = "UPDATE flights SET values_used = ?, undo_used = ?, agent = ? WHERE id = ?"
TOUCH = "UPDATE sessions SET touched_at = ?, address = ?, flight_id = ? WHERE id = ?"
COUNT = "SELECT count(*), count(owner = :owner OR NULL) FROM sessions"
EVICT = """
    DELETE FROM sessions WHERE id = (
        SELECT sessions.id FROM sessions JOIN flights ON flights.id = flight_id
        WHERE (actions = '' OR number IS NOT NULL) AND (:all OR owner = :owner)
        ORDER BY actions != '', touched_at LIMIT 1
    )
"""
Result = TypeVar("Result")


@dataclass
class Session:
    """A caller's place on the server, with the episode in memory.

    Attributes:
        flight_id: The id of its flight.
        episode: The episode after all actions.
        provenance: Who flies.
        revision: The number of changes of the flight's row.
        unstored: The actions that the row does not contain, as digits.
    """

    flight_id: str
    episode: Episode
    provenance: Provenance
    revision: int = 0
    unstored: str = ""

    @property
    def has_ended(self) -> bool:
        """Whether the flight has ended with the last of the unstored actions."""
        return self.unstored != "" and self.episode.ended

    @property
    def episode_id(self) -> str | None:
        """The id of the finished flight in the store; None before the end."""
        return self.flight_id if self.episode.ended else None

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
        self.flight_id, self.episode, self.revision, self.unstored = new_id(), episode, 0, ""

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
            flying = not self.episode.ended
            reward = self.episode.step(action)
            if flying:
                self.unstored += str(int(action))
            return reward
        if after != flown - 1 or self.episode.actions[-1] != action:
            detail = f"X-Step-Count is {after}, but the session has flown {flown} steps: see GET /state"
            raise EpisodeError(detail)
        if self.episode.ended:
            # A step after the end may have changed the message.
            self._fly_again(flown)
        return self.episode.reward_last

    def undo(self) -> None:
        """Take back the last step."""
        self._fly_again(self.episode.steps - 1)
        self.unstored = self.unstored[:-1]
        self.provenance = self.provenance.model_copy(update={"undo_used": True})

    def use_values(self) -> None:
        """Note that a person has turned on values."""
        self.provenance = self.provenance.model_copy(update={"values_used": True})

    def _fly_again(self, steps: int) -> None:
        flown = self.episode
        self.episode = Episode(flown.task, flown.reward_profile, flown.seed).fly(flown.actions[:steps])


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
        self._database.leave_checkpoints()
        self._clock = clock
        self._in_memory: OrderedDict[str, Session] = OrderedDict()
        """Sessions by id; only whoever writes to the database uses them."""

    def open(
        self,
        episode: Episode,
        agent: str | Provenance,
        address: str | None = None,
        owner: str = "",
        flight_id: str | None = None,
    ) -> str:
        """Open a session that goes on with a flight and return its secret id.

        If there is no room, the session without steps ends that was idle longest, or else the finished one. An owner
        with sessions evicts only its own.

        Args:
            episode: The episode.
            agent: Who flies.
            address: The address whose callers share it without naming it (`unnamed`).
            owner: The address that opens it, which has a share of the sessions (`in_share`); empty if it is unknown.
            flight_id: The id of the flight; None for a new one.

        Raises:
            CapacityError: if all sessions are taken, or the owner has its share.
            InvalidValueError: if the agent's name is not one printable line.
            StoreError: if it could not be written.
        """
        session_id, flight_id = secrets.token_urlsafe(24), flight_id or new_id()
        provenance = Provenance.of(agent)
        with self._database.writing() as connection:
            # An address has at most one unnamed session.
            connection.execute("UPDATE sessions SET address = NULL WHERE address = ?", (address,))
            self._make_room(connection, owner)
            insert_flight(connection, flight_id, episode, provenance)
            row = (session_id, flight_id, self._clock(), address, owner)
            connection.execute("INSERT INTO sessions VALUES (?, ?, ?, ?, ?)", row)
            self._make_room_in_memory()
            self._in_memory[session_id] = Session(flight_id, episode.copy(), provenance)
        if episode.ended:
            self._store.show()
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
            address: The address of a caller without an id, who shares the session of the address. One without steps
                is not reused, because who opened it may still use its id.
            owner: As `open`.

        Returns:
            The session, and the episode at its start.

        Raises:
            CapacityError: as `open`.
            DroneEnvError: as `start`.
        """
        last = session_id if address is None else self.unnamed(address)
        with self._database.reading() as connection:
            row = None if last is None else _find(connection, last)
        episode = start(None if row is None else row["seed"])
        if last is not None and row is not None and (row["actions"] or address is None):
            with suppress(NoSessionError):  # it has ended or been named meanwhile
                self.use(last, lambda session: session.begin(episode.copy(), agent), address)
                return last, episode
        return self.open(episode, agent or ANONYMOUS, address, owner), episode

    def use(self, session_id: str, change: Callable[[Session], Result], address: str | None = None) -> Result:
        """Call a function that may change a session, store the changes in one transaction, and return its result.

        If it raises, nothing is changed. A call counts as use.

        Args:
            session_id: The session.
            change: The function.
            address: The address of a caller that does not name the session. A caller that names it makes it private.

        Raises:
            NoSessionError: if there is no such session, or somebody has named that of the address.
            StoreError: if the store stays busy for 30 s or cannot be written, or the function uses another session.
        """
        has_ended = False
        with self._database.lock:
            with self._database.writing() as connection:
                row, session = _row(connection, session_id), self._in_memory.pop(session_id, None)
                if address is not None and row["address"] != address:
                    raise NoSessionError("this session has been named meanwhile: send its id")
                if session is None or (session.flight_id, session.revision) != (row["id"], row["revision"]):
                    session = _session(row)
                    self._make_room_in_memory()
                by = session.provenance
                result = change(session)
                connection.execute(TOUCH, (self._clock(), address, session.flight_id, session_id))
                if session.flight_id != row["id"]:
                    connection.execute("DELETE FROM flights WHERE id = ? AND number IS NULL", (row["id"],))
                    insert_flight(connection, session.flight_id, session.episode, session.provenance)
                elif session.unstored or session.provenance is not by:
                    has_ended = _change(connection, session, by)
            # Only after the commit: a session that could not be stored is flown again from its row.
            self._in_memory[session_id] = session
        if has_ended:
            self._store.show()
        return result

    def read(self, session_id: str) -> Session:
        """Return a copy of a session, which does not change. This does not count as use.

        Raises:
            NoSessionError: if there is no such session.
            StoreError: if the store cannot be read.
        """
        with self._database.reading() as connection:
            row = _row(connection, session_id)
        return _session(row)

    def check(self, session_id: str) -> None:
        """Check that there is a session.

        Raises:
            NoSessionError: if there is none.
        """
        with self._database.reading() as connection:
            _row(connection, session_id)

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
        with self._database.writing() as connection:
            _row(connection, session_id)
            connection.execute("DELETE FROM sessions WHERE id = ?", (session_id,))

    def touch(self) -> None:
        """Count all sessions as used now.

        Raises:
            StoreError: if it could not be written.
        """
        with self._database.writing() as connection:
            connection.execute("UPDATE sessions SET touched_at = ?", (self._clock(),))

    def expire(self) -> int:
        """End the idle sessions and return their number. Writes in any case, to see whether the disk has room.

        Call it every few seconds: it also moves SQLite's log to the file.

        Raises:
            StoreError: if it could not be written.
        """
        with self._database.writing() as connection:
            connection.execute(f"PRAGMA user_version = {VERSION}")
            ended = self._end_idle(connection)
        self._database.checkpoint()
        return ended

    def _make_room_in_memory(self) -> None:
        """Forget the sessions that were used longest ago, so that one more makes at most `capacity`."""
        while len(self._in_memory) >= self.capacity:
            self._in_memory.popitem(last=False)

    def _make_room(self, connection: sqlite3.Connection, owner: str) -> None:
        """End idle sessions, and the one that is needed least if there is no room.

        Raises:
            CapacityError: if all are needed.
        """
        self._end_idle(connection)
        taken, own = connection.execute(COUNT, {"owner": owner}).fetchone()
        if in_share(own if owner else 0, taken, self.capacity):
            return
        if connection.execute(EVICT, {"all": not (owner and own), "owner": owner}).rowcount:
            return
        if taken < self.capacity:
            share = f"this address has {own} of {self.capacity} sessions, its share: end one"
            raise CapacityError(f"{share}, or raise DRONE_ENV_CAPACITY")
        raise CapacityError(f"all {self.capacity} sessions are taken: try again later")

    def _end_idle(self, connection: sqlite3.Connection) -> int:
        limit = self._clock() - self.idle_seconds
        return connection.execute("DELETE FROM sessions WHERE touched_at <= ?", (limit,)).rowcount


def _find(connection: sqlite3.Connection, session_id: str) -> sqlite3.Row | None:
    """Return the flight of a session, its revision and the session's address; None if there is no such session."""
    # Ids are ASCII, and SQLite rejects lone surrogates.
    return connection.execute(SELECT_SESSION, (session_id if session_id.isascii() else "",)).fetchone()


def _row(connection: sqlite3.Connection, session_id: str) -> sqlite3.Row:
    """As `_find`, but raise `NoSessionError` if there is no such session."""
    row = _find(connection, session_id)
    if row is None:
        raise NoSessionError("there is no such session: it has ended, was idle for too long, or never was")
    return row


def _session(row: sqlite3.Row) -> Session:
    """Fly the flight of a session again."""
    *flight, revision, _ = row
    flown = Flight(*flight)
    return Session(flown.id, flown.fly(), flown.provenance, revision)


def _change(connection: sqlite3.Connection, session: Session, before: Provenance) -> bool:
    """Store what a session has flown, and its provenance if it differs. Return whether this finished the flight."""
    has_ended, by = session.has_ended, session.provenance
    kept = session.episode.steps - len(session.unstored)
    connection.execute(FLY, (kept, session.unstored, session.flight_id))
    if by is not before:
        connection.execute(USE_HELP, (by.values_used, by.undo_used, by.label, session.flight_id))
    session.revision += 1
    session.unstored = ""
    if has_ended:
        finish_flight(connection, session.flight_id, session.episode)
    return has_ended


def in_share(own: int, taken: int, capacity: int) -> bool:
    """Return whether an address may take one more of `capacity` places: it holds fewer than are free.

    One address thus takes at most half of the places, two take a third each, and a newcomer finds one free.

    Args:
        own: The places that the address holds.
        taken: The places that all addresses hold.
        capacity: The number of places.
    """
    return own < capacity - taken
