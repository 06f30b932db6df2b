"""The store: finished episodes, open sessions and optima in one SQLite file.

Several processes and threads may use one folder at once. Each finished call survives SIGKILL. Power
loss may undo the last transactions, but never leaves a broken file. The folder must be on a local disk. Open a store in
each process: it does not survive a fork.
"""

import secrets
import sqlite3
import time
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from typing_extensions import Self

from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import CapacityError, InvalidValueError, NoSessionError, StoreError, UnknownNameError
from drone_env.results.database import BUSY_SECONDS, Database
from drone_env.results.finished import (
    SELECT_BEST,
    SELECT_BY_MAP,
    SELECT_ROWS,
    Analysis,
    EpisodeSummary,
    StoredEpisode,
    analyse,
    check_agent,
    digits_of,
    insert_episode,
    results_by_agent,
)
from drone_env.results.memory_view import MemoryView
from drone_env.results.optima import Map, Optima, Submit
from drone_env.results.record import EpisodeRecord, replay
from drone_env.results.result import Results
from drone_env.results.sessions import Session, flight_of, in_share, new_episode_id

FILE_NAME = "drone_env.sqlite3"
VIEW_NAME = "memory.json"
PAGE = 100
PATIENCE = 0.5
"""Default time to wait for optima, in seconds."""
MOST_ROWS = 1 << 31
NEWEST = "ORDER BY number DESC LIMIT ?"
SELECT_STORED = "SELECT number, episode FROM episodes"
COUNT = "SELECT count(*) FROM sessions"
END = "DELETE FROM sessions WHERE id = ?"
OWN = "SELECT count(*) FROM sessions WHERE owner = ?"
EVICTABLE = """
    SELECT id FROM sessions
    WHERE (actions = '' OR episode_id IS NOT NULL AND touched_at <= :finished) AND (:all OR owner = :owner)
    ORDER BY actions != '', touched_at
"""
EXPIRE = "DELETE FROM sessions WHERE touched_at <= ?"
UPDATE = """
    UPDATE sessions SET task = :task, task_version = :task_version, seed = :seed, agent = :agent,
        reward_profile = :reward_profile, actions = :actions, episode_id = :episode_id, touched_at = :now,
        address = :address
    WHERE id = :id
"""
FINISHED_SECONDS = 30.0
"""A finished session is not evicted for this long: its owner still needs the score."""
TO_DIGITS = bytes.maketrans(bytes(range(10)), b"0123456789")
TO_NUMBERS = bytes.maketrans(b"0123456789", bytes(range(10)))
"""The store writes actions as digits; these tables translate bytes of numbers to digits and back."""


class Store:
    """The store in `folder`: `drone_env.sqlite3`, and `memory.json` as a view of the last 100 finished episodes.

    Threads may share it. A context manager.

    Args:
        folder: Created if it is missing.
        clock: Returns seconds since 1970, for the idle time of sessions; None for `time.time`.
        busy_seconds: Maximum time to wait for other writers.
        submit: Starts to solve maps in another process: the map of each stored episode, and the maps of a list. If
            None, a thread of the store solves the maps of a list.

    Raises:
        OSError: if the folder or the file cannot be created.
        StoreError: if the file is not a store of this version, cannot be opened, or contains flights of another task
            under the name of a registered one.
    """

    def __init__(
        self,
        folder: str | Path,
        clock: Callable[[], float] | None = None,
        busy_seconds: float = BUSY_SECONDS,
        submit: Submit | None = None,
    ) -> None:
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self._database = Database(self.folder / FILE_NAME, busy_seconds)
        try:
            with self._database.reading() as connection:
                for task in list(TASKS.values()):
                    self._database.check_task(connection, task)
            self._view = MemoryView(self.folder / VIEW_NAME, self._newer)
        except BaseException:
            self._database.close()
            raise
        self._clock = clock or time.time
        self._solves_all = submit is not None
        self._optima = Optima(self._database, submit)

    def close(self) -> None:
        """Close the file; a second call does nothing. Waits for `memory.json`."""
        self._optima.close()
        self._view.close()
        self._database.close()

    def check(self) -> None:
        """Check that the file was not deleted or replaced, as every method that writes does, and that writes succeed.

        Raises:
            StoreError: if nothing can be stored.
        """
        self._database.check()
        if self._database.failed:
            raise StoreError(f"store {self._database.path}: the last write failed")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # Finished episodes

    def add_episode(
        self, episode: EpisodeRecord | Episode, agent: str | None = None, episode_id: str | None = None
    ) -> str:
        """Store a finished episode and return its id; `memory.json` shows it a moment later.

        A record is replayed and verified first.

        Args:
            episode: The flight.
            agent: Name of the pilot of an `Episode`; a record contains it.
            episode_id: Its id, 16 hex digits; None for a new one. If the id is stored already, nothing changes.

        Raises:
            EpisodeError: if the episode has not ended.
            InvalidValueError: if the record does not fit its flight, `agent` is given with a record, missing with an
                `Episode` or not one printable line, or task or profile differ from the registered ones.
            UnknownNameError: if there is no such task, version or reward profile.
            StoreError: if it could not be written; nothing is stored then.
        """
        if (agent is None) != isinstance(episode, EpisodeRecord):
            raise InvalidValueError("agent belongs to an Episode; a record names its own")
        if isinstance(episode, EpisodeRecord):
            agent, episode = episode.agent, replay(episode)
        stored = StoredEpisode.of(episode_id or new_episode_id(), episode, str(agent))
        self._add([stored])
        return stored.id

    def episode(self, episode_id: str) -> StoredEpisode:
        """Return the episode of an id.

        Raises:
            UnknownNameError: if there is none; the message names no other episode, since ids are not public.
            StoreError: if the store cannot be read.
        """
        if episode_id.isascii():
            for row in self._read(f"{SELECT_STORED} WHERE id = ?", (episode_id,)):
                return self._stored(row)
        raise UnknownNameError("episode", episode_id, ())

    def listed(
        self,
        n: int,
        task: str | TaskConfig | None = None,
        agent: str | None = None,
        before: int | None = None,
        after: int | None = None,
        episode_id: str | None = None,
        seed: int | None = None,
        patience: float | None = None,
    ) -> list[EpisodeSummary]:
        """Return the last `n` finished episodes with the optima of their maps, newest first.

        Unknown optima are solved as in `analysis`, except those of tasks that are not registered. All filters that are
        not None must hold.

        Args:
            n: How many, 0 or more.
            task: The task.
            agent: The pilot.
            before: The episode was stored before the one of this number.
            after: The episode was stored after the one of this number.
            episode_id: Its id.
            seed: The map.
            patience: Seconds to wait for optima; None for `PATIENCE`.

        Raises:
            UnknownNameError: if there is no such task.
            InvalidValueError: if n is negative.
            StoreError: if the store cannot be read.
        """
        if n < 0:
            raise InvalidValueError(f"n must be at least 0, got {n}")
        filters = {"agent =": agent, "number <": before, "number >": after, "id =": episode_id, "seed =": seed}
        where, values = _where(task, filters)
        query = f"{SELECT_ROWS} {where} {NEWEST}", (*values, min(n, MOST_ROWS))
        return [EpisodeSummary(**row) for row in self._read_solved(*query, "seed", patience)]

    def by_map(self, task: str | TaskConfig, patience: float | None = None) -> dict[str, Results]:
        """Return the results of each agent on a task, one row per map; optima as in `listed`.

        Raises:
            UnknownNameError: if there is no such task.
            StoreError: if the store cannot be read.
        """
        where, values = _where(task)
        return results_by_agent(self._read_solved(SELECT_BY_MAP.format(where=where), values, "seeds", patience))

    def best(self, task: str | TaskConfig, seed: int, agent: str, since: float, n: int) -> list[EpisodeSummary]:
        """Return the best flights of an agent over a map, with and without a name: one for each name, the best first.

        Flights of equal score and length are in the order of storing. A name follows the agent in parentheses.

        Args:
            task: The task.
            seed: The map.
            agent: The agent, without a name.
            since: The earliest time of storing, in seconds since 1970.
            n: How many, 0 or more.

        Raises:
            UnknownNameError: if there is no such task.
            StoreError: if the store cannot be read.
        """
        where, values = _where(task, {"seed =": seed, "finished_at >=": since})
        return [
            EpisodeSummary(**row) for row in self._read(SELECT_BEST.format(where=where), (*values, agent, agent, n))
        ]

    def flown_before(self, record: EpisodeRecord) -> list[EpisodeSummary]:
        """Return the flights of any agent with the map, actions and reward profile of a record, oldest first.

        Raises:
            UnknownNameError: if there is no such task.
            StoreError: if the store cannot be read.
        """
        flown = {"seed =": record.seed, "reward_profile =": record.reward_profile, "actions =": digits_of(record)}
        where, values = _where(record.task, flown)
        return [EpisodeSummary(**row) for row in self._read(f"{SELECT_ROWS} {where} ORDER BY number", values)]

    def stored_ids(self, episode_ids: Iterable[str]) -> set[str]:
        """Return the ids that the store contains."""
        return {id_ for id_ in episode_ids if self._read("SELECT 1 FROM episodes WHERE id = ?", (id_,))}

    def episodes(self) -> Iterator[StoredEpisode]:
        """Yield all finished episodes, oldest first.

        Raises:
            StoreError: if the store cannot be read.
        """
        number = 0
        # In pages, since an open reader prevents SQLite from truncating its log.
        while page := self._read(f"{SELECT_STORED} WHERE number > ? ORDER BY number LIMIT ?", (number, PAGE)):
            yield from map(self._stored, page)
            number = page[-1]["number"]

    def analysis(self, task: str | TaskConfig, last: int = 1000, patience: float | None = None) -> Analysis:
        """Return statistics of the last episodes of a task.

        Each map is solved once, in the background; this call waits up to `patience` seconds. `mean_regret` omits the
        maps that are not solved by then.

        Raises:
            UnknownNameError: if there is no such task.
            InvalidValueError: if `last` is below 1.
            StoreError: if the store cannot be read.
        """
        if last < 1:
            raise InvalidValueError(f"last must be at least 1, got {last}")
        rows = self.listed(last, task, patience=patience)
        where, values = _where(task)
        ((total,),) = self._read(f"SELECT count(*) FROM episodes {where}", values)
        return analyse(get_task(task), total, rows)

    # Sessions

    def open_session(
        self,
        episode: Episode,
        agent: str,
        capacity: int,
        address: str | None = None,
        owner: str = "",
        keep: Collection[str] = (),
    ) -> str:
        """Open a session on an episode at its start and return its secret id.

        If there is no room, the session without steps that was idle longest is evicted, or else the finished one that
        was idle longest, and for at least 30 s. An owner with sessions evicts only its own.

        Args:
            episode: The episode.
            agent: Name of the pilot.
            capacity: Maximum number of open sessions.
            address: The address whose callers share it without naming it (`unnamed_session`).
            owner: The address that opens it, which has a share of the sessions (`in_share`); empty if it is unknown.
            keep: Sessions that are not evicted.

        Raises:
            CapacityError: if `capacity` sessions are open, or the owner has its share; expire the idle ones first.
            InvalidValueError: if the agent's name is not one printable line.
            StoreError: if it could not be written.
        """
        session_id = secrets.token_urlsafe(24)
        now, agent = self._clock(), check_agent(agent)
        row = (session_id, *flight_of(episode), agent, "", None, now, now, address, owner)
        with self._database.writing() as connection:
            self._database.check_task(connection, episode.task, claim=True)
            (taken,) = connection.execute(COUNT).fetchone()
            own = connection.execute(OWN, (owner,)).fetchone()[0] if owner else 0
            if not in_share(own, taken, capacity):
                values = {"finished": now - FINISHED_SECONDS, "all": not own, "owner": owner}
                found = (row["id"] for row in connection.execute(EVICTABLE, values))
                evicted = next((id_ for id_ in found if id_ not in keep), None)
                if evicted is None and taken < capacity:
                    raise CapacityError(
                        f"this address has {own} of {capacity} sessions, its share: end one, or raise "
                        "DRONE_ENV_CAPACITY"
                    )
                if evicted is None:
                    raise CapacityError(f"all {capacity} sessions are taken: try again later")
                connection.execute(END, (evicted,))
            # An address has at most one unnamed session.
            connection.execute("UPDATE sessions SET address = NULL WHERE address = ?", (address,))
            connection.execute("INSERT INTO sessions VALUES (?,?,?,?,?,?,?,?,?,?,?,?)", row)
        return session_id

    @contextmanager
    def session(self, session_id: str, address: str | None = None) -> Generator[Session, None, None]:
        """Yield a session to change. The block locks the store: keep it short, without `await`.

        At its end the changes and the finished episodes are written in one transaction. If the block raises, nothing
        is written, and its `episode` must not be used again. Entering counts as use.

            with store.session(id) as session:
                reward = advance(session, action)

        Args:
            session_id: The session.
            address: The address of a caller that does not name the session. A caller that names it makes it private.

        Raises:
            NoSessionError: if there is no such session, or somebody has named that of the address.
            StoreError: if the store stays busy for 30 s, cannot be written, or the same thread is already in a block.
        """
        with self._database.writing() as connection:
            session = _session(connection, session_id)
            if address is None:
                session.address = None
            elif session.address != address:
                raise NoSessionError("this session has been named meanwhile: send its id")
            flight = session.flight
            yield session
            if session.flight != flight or session.finished:
                self._database.check_task(connection, get_task(session.task, session.task_version), claim=True)
            for stored in session.finished:
                insert_episode(connection, stored)
            actions = bytes(session.actions).translate(TO_DIGITS).decode()
            connection.execute(UPDATE, {**vars(session), "actions": actions, "now": self._clock()})
        self._noted(session.finished)

    def keep(self, session: Session) -> None:
        """Store the finished episodes of a session that has no row.

        Raises:
            StoreError: if they could not be written; the session then still contains them.
        """
        self._add(session.finished)
        session.finished = []

    def read_session(self, session_id: str) -> Session:
        """Return a session to read only. This does not wait for writers and does not count as use.

        Raises:
            NoSessionError: if there is no such session.
            StoreError: if the store cannot be read.
        """
        with self._database.reading() as connection:
            return _session(connection, session_id)

    def unnamed_session(self, address: str) -> str | None:
        """Return the session that the callers of an address share; None if there is none, or somebody has named it.

        Raises:
            StoreError: if the store cannot be read.
        """
        found = self._read("SELECT id FROM sessions WHERE address = ?", (address,))
        return found[0][0] if found else None

    def end_session(self, session_id: str) -> None:
        """End a session.

        Raises:
            NoSessionError: if there is no such session.
            StoreError: if it could not be written.
        """
        with self._database.writing() as connection:
            _session(connection, session_id)
            connection.execute(END, (session_id,))

    def touch_sessions(self, session_ids: Iterable[str]) -> None:
        """Count sessions as used now; this does not bring back sessions that are gone.

        Raises:
            StoreError: if it could not be written.
        """
        now = self._clock()
        with self._database.writing() as connection:
            connection.executemany(
                "UPDATE sessions SET touched_at = ? WHERE id = ?", [(now, id_) for id_ in session_ids]
            )

    def expire_sessions(self, idle_seconds: float) -> int:
        """End the sessions that are idle for this long and return their number.

        Raises:
            StoreError: if it could not be written.
        """
        self._database.probe()
        with self._database.writing() as connection:
            return connection.execute(EXPIRE, (self._clock() - idle_seconds,)).rowcount

    def count_sessions(self) -> int:
        """Return the number of open sessions.

        Raises:
            StoreError: if the store cannot be read.
        """
        return self._read(COUNT)[0][0]

    def _add(self, finished: Sequence[StoredEpisode]) -> None:
        """Store finished episodes in one transaction."""
        with self._database.writing() as connection:
            for stored in finished:
                task = get_task(stored.record.task, stored.record.task_version)
                self._database.check_task(connection, task, claim=True)
                insert_episode(connection, stored)
        self._noted(finished)

    def _noted(self, stored: Sequence[StoredEpisode]) -> None:
        """Show new episodes in `memory.json` and start to solve their maps."""
        if stored:
            self._view.refresh()
            if self._solves_all:
                for one in stored:
                    self._read_solved(f"{SELECT_ROWS} WHERE id = ?", (one.id,), "seed", 0)

    def _read_solved(
        self, query: str, values: tuple[object, ...], seed: str, patience: float | None
    ) -> list[sqlite3.Row]:
        """Run a query with a column `solved`; if maps are not solved, wait for the solver and run it again.

        Args:
            query: The query.
            values: Its values.
            seed: Its column with the number of the map.
            patience: Seconds to wait; None for `PATIENCE`.
        """
        rows = self._read(query, values)
        maps: dict[Map, None] = {}
        for row in rows:
            if not row["solved"]:
                with suppress(UnknownNameError):  # the plugin of the task is gone
                    maps[get_task(row["task"], row["task_version"]), row[seed]] = None
        if not maps:
            return rows
        self._optima.solve(maps, PATIENCE if patience is None else patience)
        return self._read(query, values)

    def _read(self, query: str, values: tuple[object, ...] = ()) -> list[sqlite3.Row]:
        with self._database.reading() as connection:
            return connection.execute(query, values).fetchall()

    def _stored(self, row: sqlite3.Row) -> StoredEpisode:
        name = f"episode {row['number']} of {self._database.path} is damaged"
        return StoredEpisode.read(row["episode"], name)

    def _newer(self, after: int, n: int) -> list[tuple[int, str]]:
        return [tuple(row) for row in self._read(f"{SELECT_STORED} WHERE number > ? {NEWEST}", (after, n))[::-1]]


def _session(connection: sqlite3.Connection, session_id: str) -> Session:
    """Read a session.

    Raises:
        NoSessionError: if there is none.
    """
    # Ids are ASCII, and SQLite rejects lone surrogates.
    known = session_id if session_id.isascii() else ""
    row = connection.execute("SELECT * FROM sessions WHERE id = ?", (known,)).fetchone()
    if row is None:
        raise NoSessionError("there is no such session: it has ended, was idle for too long, or never was")
    columns: dict[str, Any] = {**row, "actions": tuple(row["actions"].encode().translate(TO_NUMBERS))}
    return Session(**columns)


def _where(task: str | TaskConfig | None, filters: Mapping[str, Any] | None = None) -> tuple[str, tuple[Any, ...]]:
    """Return a WHERE clause for a task and for the filters that are not None, with its values.

    Raises:
        UnknownNameError: if there is no such task.
    """
    known = None if task is None else get_task(task)
    of_task = {} if known is None else {"task =": known.id, "task_version =": known.version}
    given = {name: value for name, value in {**of_task, **(filters or {})}.items() if value is not None}
    return f"WHERE {' AND '.join([f'{name} ?' for name in given])}" if given else "", tuple(given.values())
