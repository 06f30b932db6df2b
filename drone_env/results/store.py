"""All that outlives the process: finished episodes and open sessions, in one SQLite file.

Several processes and threads may use one folder at once. What a method has returned survives the death of the process
at any moment, SIGKILL included; power loss may take the last transactions, and never leaves a broken file. The folder
must be on a local disk. A store must not be carried across a fork: open one in each process.
"""

import secrets
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from typing_extensions import Self

from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import CapacityError, InvalidValueError, NoSessionError, UnknownNameError
from drone_env.results.database import BUSY_SECONDS, Database
from drone_env.results.finished import (
    SELECT_BY_MAP,
    SELECT_ROWS,
    SELECT_STORED,
    Analysis,
    EpisodeSummary,
    StoredEpisode,
    analyse,
    check_agent,
    insert_episode,
    results_by_agent,
    selection,
    stored_episode,
)
from drone_env.results.memory_view import MemoryView
from drone_env.results.optima import Map, Optima, Submit
from drone_env.results.record import EpisodeRecord, replay
from drone_env.results.result import Results
from drone_env.results.sessions import (
    EPISODE_ID,
    Session,
    end_finished,
    end_idle,
    end_session,
    flight_of,
    new_episode_id,
    session_row,
    steady_clock,
    update_session,
)

FILE_NAME = "drone_env.sqlite3"
VIEW_NAME = "memory.json"
PAGE = 100
PATIENCE = 0.5
"""Default time to wait for optima, in seconds."""
MOST_ROWS = 1 << 31
NEWEST = "ORDER BY number DESC LIMIT ?"
COUNT = "SELECT count(*) FROM sessions"


class Store:
    """The store in `folder`: `drone_env.sqlite3`, and `memory.json` as a view of the last 100 finished episodes.

    Safe to share between threads. `close` it, or use it in a `with`.

    Args:
        folder: Made where it is missing.
        clock: Gives the time, in seconds since 1970: by it sessions are idle. None for one that starts at the
            machine's time and runs on evenly, whatever that is set to. It never tells less than the newest use of a
            session.
        busy_seconds: For how long to wait while others write.
        submit: Starts to solve maps elsewhere: the map of each episode that is stored, and those of a list. If None, a
            thread of the store solves those of a list.

    Raises:
        OSError: if the folder or the file cannot be made.
        StoreError: if the file in it is no store of this version, cannot be opened, or
            keeps flights of another task under the name of one that is registered.
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
            self._clock = self._continued(clock or steady_clock())
            self._view = MemoryView(self.folder / VIEW_NAME, self._newer)
        except BaseException:
            self._database.close()
            raise
        self._solves_all = submit is not None
        self._optima = Optima(self._database, submit)

    def close(self) -> None:
        """Close the file; a second call does nothing. Waits for `memory.json`."""
        self._optima.close()
        self._view.close()
        self._database.close()

    def check(self) -> None:
        """See whether the file is still where it was opened; every method that writes does so, too."""
        self._database.check()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # Finished episodes

    def add_episode(
        self, episode: EpisodeRecord | Episode, agent: str | None = None, episode_id: str | None = None
    ) -> str:
        """Store a finished episode and return its id; `memory.json` shows it a moment later.

        A record is flown again first, so that nothing is stored that is not so; an `Episode` is taken as it is.

        Args:
            episode: The flight.
            agent: Who flew an `Episode`; a record says so itself.
            episode_id: Its id, 16 hex digits, for one that may be stored already: the one of this id is then kept as it
                is. None for a new one.

        Raises:
            EpisodeError: if the episode has not ended.
            InvalidValueError: if the record does not fit its flight, `agent` is given with a record or not given with
                an `Episode`, is not one printable line, or task and profile are not the registered ones of their names.
            UnknownNameError: if there is no such task, version or reward profile.
            StoreError: if it could not be written; then nothing is stored.
        """
        if (agent is None) != isinstance(episode, EpisodeRecord):
            raise InvalidValueError("agent belongs to an Episode; a record names its own")
        if isinstance(episode, EpisodeRecord):
            agent, episode = episode.agent, replay(episode)
        if episode_id is not None and not EPISODE_ID.fullmatch(episode_id):
            raise InvalidValueError(f"the id of an episode is 16 hex digits, got {episode_id!r}")
        stored = StoredEpisode.of(episode_id or new_episode_id(), episode, str(agent))
        with self._database.writing() as connection:
            self._database.check_task(connection, episode.task, claim=True)
            insert_episode(connection, stored)
        self._noted([stored])
        return stored.id

    def episode(self, episode_id: str) -> StoredEpisode:
        """The episode of this id.

        Raises:
            UnknownNameError: if there is none; the message names no other, since anybody may ask.
            StoreError: if the store cannot be read.
        """
        if episode_id.isascii():
            for _, stored in self._stored("WHERE id = ?", (episode_id,)):
                return stored
        raise UnknownNameError("episode", episode_id, ())

    def latest(self, n: int, task: str | TaskConfig | None = None) -> list[StoredEpisode]:
        """The last `n` finished episodes, of one task or of all, newest first.

        Raises:
            UnknownNameError: if there is no such task.
            InvalidValueError: if n is negative.
            StoreError: if the store cannot be read.
        """
        where, values = selection(task)
        return [stored for _, stored in self._stored(f"{where} {NEWEST}", (*values, _at_most(n)))]

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
        """The last `n` finished episodes with the optima of their maps, newest first.

        Optima that are not known yet are solved as for `analysis`; those of tasks that are not registered stay unknown.

        Args:
            n: How many, 0 or more.
            task: Of which task; None for all.
            agent: By whom; None for all.
            before: Only those that were stored before the one of this number.
            after: Only those that were stored after the one of this number.
            episode_id: Only the one of this id.
            seed: Only those over the map of this number.
            patience: Seconds to wait for optima; None for `PATIENCE`.

        Raises:
            UnknownNameError: if there is no such task.
            InvalidValueError: if n is negative.
            StoreError: if the store cannot be read.
        """
        where, values = selection(task, agent, before, after, episode_id, seed)
        chosen = f"{where} {NEWEST}", (*values, _at_most(n))
        found = self._rows(*chosen)
        return self._rows(*chosen) if self._solve(_unsolved(found), patience) else found

    def by_map(self, task: str | TaskConfig, patience: float | None = None) -> dict[str, Results]:
        """All finished episodes of a task by agent, one row per map; optima as for `listed`.

        Raises:
            UnknownNameError: if there is no such task.
            StoreError: if the store cannot be read.
        """
        where, values = selection(task)
        chosen = SELECT_BY_MAP.format(where=where), values
        found = self._read(*chosen)
        unsolved = [(name, version, row[0]) for _, name, version, solved, _, _, *row in found if not solved]
        return results_by_agent(self._read(*chosen) if self._solve(unsolved, patience) else found)

    def kept(self, episode_ids: Iterable[str]) -> set[str]:
        """Those of these ids that the store has."""
        return {id_ for id_ in episode_ids if self._read("SELECT 1 FROM episodes WHERE id = ?", (id_,))}

    def episodes(self) -> Iterator[StoredEpisode]:
        """All finished episodes, oldest first, read as they are asked for.

        Raises:
            StoreError: if the store cannot be read.
        """
        number = 0
        # In pages, since a reader that stays open keeps the log of the file from being folded back.
        while page := self._stored("WHERE number > ? ORDER BY number LIMIT ?", (number, PAGE)):
            yield from (stored for _, stored in page)
            number = page[-1][0]

    def analysis(self, task: str | TaskConfig, last: int = 1000, patience: float | None = None) -> Analysis:
        """Figures of the last episodes of a task.

        Optima are solved once per map, in a thread of the store's, and kept; this waits `patience` seconds for them.
        The maps that are not solved by then are left out of `mean_regret` and are there in a later call.

        Raises:
            UnknownNameError: if there is no such task.
            InvalidValueError: if `last` is below 1.
            StoreError: if the store cannot be read.
        """
        if last < 1:
            raise InvalidValueError(f"last must be at least 1, got {last}")
        known = get_task(task)
        rows = self.listed(last, known, patience=patience)
        where, values = selection(known)
        ((total,),) = self._read(f"SELECT count(*) FROM episodes {where}", values)
        return analyse(known, total, rows)

    # Sessions

    def open_session(self, episode: Episode, agent: str, capacity: int, address: str | None = None) -> str:
        """Open a session on an episode at its start, and return its id, which cannot be guessed.

        If there is no room, the session that was finished first gives way, if it has not been used for 30 s.

        Args:
            episode: The episode.
            agent: Who flies.
            capacity: How many sessions may be open.
            address: Where the callers are that share it without naming it (`unnamed_session`).

        Raises:
            CapacityError: if `capacity` sessions are open already; expire the idle ones first.
            InvalidValueError: if the agent's name is not one printable line.
            StoreError: if it could not be written.
        """
        session_id = secrets.token_urlsafe(24)
        now, agent = self._clock(), check_agent(agent)
        row = (session_id, *flight_of(episode), agent, "", None, now, now, address)
        with self._database.writing() as connection:
            self._database.check_task(connection, episode.task, claim=True)
            (taken,) = connection.execute(COUNT).fetchone()
            if taken >= capacity and not end_finished(connection, now):
                raise CapacityError(f"all {capacity} sessions are taken: try again later")
            # One at most is of those who name none: where it is named, they are not to find one that they left before.
            connection.execute("UPDATE sessions SET address = NULL WHERE address = ?", (address,))
            connection.execute("INSERT INTO sessions VALUES (?,?,?,?,?,?,?,?,?,?,?)", row)
        return session_id

    @contextmanager
    def session(self, session_id: str, address: str | None = None) -> Generator[Session, None, None]:
        """A session to be changed. Nobody else writes to the store meanwhile: keep the block short, without `await`.

        At the end of the block its changes and the finished episodes are kept together; if the block raises, nothing is
        kept, and its `episode` must not be used again. Entering counts as use.

            with store.session(id) as session:
                reward = advance(session, action)

        Args:
            session_id: The session.
            address: Of a caller who does not name the session; who names it has it alone from then on.

        Raises:
            NoSessionError: if there never was such a session, or somebody has named that of the address.
            SessionGoneError: if it has ended or expired.
            StoreError: if the store stays busy for 30 s, cannot be written, or the block is inside another one of the
                same thread.
        """
        with self._database.writing() as connection:
            session = session_row(connection, session_id)
            if address is None:
                session.address = None
            elif session.address != address:
                raise NoSessionError("somebody has named this session meanwhile")
            flight = session.flight
            yield session
            if session.flight != flight or session.finished:
                self._database.check_task(connection, get_task(session.task, session.task_version), claim=True)
            for stored in session.finished:
                insert_episode(connection, stored)
            update_session(connection, session, self._clock())
        self._noted(session.finished)

    def keep(self, session: Session) -> None:
        """Store the finished episodes of a session that has no row.

        Raises:
            StoreError: if they could not be written; then the session still holds them.
        """
        with self._database.writing() as connection:
            for stored in session.finished:
                self._database.check_task(connection, get_task(stored.record.task), claim=True)
                insert_episode(connection, stored)
        self._noted(session.finished)
        session.finished = []

    def read_session(self, session_id: str) -> Session:
        """A session as it stands, to be read only; does not wait for writers and does not count as use.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired.
            StoreError: if the store cannot be read.
        """
        with self._database.reading() as connection:
            return session_row(connection, session_id)

    def unnamed_session(self, address: str) -> str | None:
        """The session of those at an address who name none; None where they have none, or somebody has named it.

        Raises:
            StoreError: if the store cannot be read.
        """
        found = self._read("SELECT id FROM sessions WHERE address = ?", (address,))
        return found[0][0] if found else None

    def end_session(self, session_id: str) -> None:
        """End a session: from now on it is gone.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired already.
            StoreError: if it could not be written.
        """
        with self._database.writing() as connection:
            session_row(connection, session_id)
            end_session(connection, session_id, self._clock())

    def touch_sessions(self, session_ids: Iterable[str]) -> None:
        """Count sessions as used just now; those that are gone stay so.

        Raises:
            StoreError: if it could not be written.
        """
        now = self._clock()
        with self._database.writing() as connection:
            connection.executemany(
                "UPDATE sessions SET touched_at = ? WHERE id = ?", [(now, id_) for id_ in session_ids]
            )

    def expire_sessions(self, idle_seconds: float) -> list[str]:
        """End the sessions that were not used for so long, and return their ids.

        They are remembered as gone for a week.

        Raises:
            StoreError: if it could not be written.
        """
        with self._database.writing() as connection:
            return end_idle(connection, self._clock(), idle_seconds)

    def count_sessions(self) -> int:
        """How many sessions are open.

        Raises:
            StoreError: if the store cannot be read.
        """
        return self._read(COUNT)[0][0]

    def _noted(self, stored: Sequence[StoredEpisode]) -> None:
        """Show new episodes in `memory.json`, and have their maps solved."""
        if stored:
            self._view.refresh()
            if self._solves_all:
                for one in stored:
                    self._solve(_unsolved(self._rows("WHERE id = ?", (one.id,))), 0.0)

    def _solve(self, unsolved: Iterable[tuple[str, int, int]], patience: float | None) -> bool:
        """Have maps solved, named by task, version and seed; whether there were any."""
        maps: dict[Map, None] = {}
        for name, version, seed in unsolved:
            with suppress(UnknownNameError):  # of a plugin that is gone: nobody can solve its maps
                maps[get_task(name, version), seed] = None
        if maps:
            self._optima.want(maps, PATIENCE if patience is None else patience)
        return bool(maps)

    def _continued(self, clock: Callable[[], float]) -> Callable[[], float]:
        """A clock that has gone back since the last start would let sessions live on: it begins where they are."""
        ((used,),) = self._read("SELECT coalesce(max(touched_at), 0) FROM sessions")
        ahead = max(0.0, used - clock())
        return lambda: clock() + ahead

    def _read(self, query: str, values: tuple[object, ...] = ()) -> list[Any]:
        with self._database.reading() as connection:
            return connection.execute(query, values).fetchall()

    def _rows(self, where: str, values: tuple[object, ...]) -> list[EpisodeSummary]:
        return [EpisodeSummary.of(row) for row in self._read(f"{SELECT_ROWS} {where}", values)]

    def _stored(self, where: str, values: tuple[object, ...]) -> list[tuple[int, StoredEpisode]]:
        rows = self._read(f"{SELECT_STORED} {where}", values)
        return [stored_episode(row, self._database.path) for row in rows]

    def _newer(self, after: int, n: int) -> list[tuple[int, StoredEpisode]]:
        return self._stored(f"WHERE number > ? {NEWEST}", (after, n))[::-1]


def _unsolved(rows: Iterable[EpisodeSummary]) -> list[tuple[str, int, int]]:
    return [(row.task, row.task_version, row.seed) for row in rows if not row.solved]


def _at_most(n: int) -> int:
    if n < 0:
        raise InvalidValueError(f"n must be at least 0, got {n}")
    return min(n, MOST_ROWS)
