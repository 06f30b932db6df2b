"""All that outlives the process: finished episodes and open sessions, in one SQLite file.

Several processes and threads may use one folder at once. What a method has returned survives the death of the process
at any moment, SIGKILL included; power loss may take the last transactions, and never leaves a broken file. The folder
must be on a local disk. A store must not be carried across a fork: open one in each process.
"""

import os
import secrets
import sqlite3
import time
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from datetime import datetime, timezone
from pathlib import Path

from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.episodes.analysis import Analysis, FinishedRow, analyse
from drone_env.episodes.database import Database
from drone_env.episodes.finished import StoredEpisode, check_agent
from drone_env.episodes.memory_view import MemoryView
from drone_env.episodes.optima import Optima
from drone_env.episodes.record import EpisodeRecord, parse_record, replay
from drone_env.episodes.sessions import SessionRow, known_task, new_episode_id
from drone_env.errors import CapacityError, InvalidValueError, NoSessionError, SessionGoneError, UnknownNameError

FILE_NAME = "drone_env.sqlite3"
VIEW_NAME = "memory.json"
GONE_SECONDS = 7 * 24 * 3600.0
PAGE = 100
MOST_ROWS = 1 << 31
DIGITS = {action.name: str(int(action)) for action in Action}


def data_folder() -> Path:
    """The folder of what is kept: `DRONE_ENV_DATA`, or `data` in the working directory."""
    return Path(os.environ.get("DRONE_ENV_DATA") or "data")


class Store:
    """The store in `folder`: `drone_env.sqlite3`, and `memory.json` as a view of the last 100 finished episodes.

    Safe to share between threads. `close` it, or use it in a `with`.

    Args:
        folder: Made where it is missing.

    Raises:
        OSError: if the folder or the file cannot be made.
        StoreError: if the file in it is no store, was written by a newer version of this package, or cannot be opened.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.folder.mkdir(parents=True, exist_ok=True)
        self._database = Database(self.folder / FILE_NAME)
        try:
            self._view = MemoryView(self.folder / VIEW_NAME, self._newer)
        except BaseException:
            self._database.close()
            raise
        self._optima = Optima(self._database)

    def close(self) -> None:
        """Close the file; a second call does nothing. Waits for `memory.json`, and the map that is being solved."""
        self._optima.close()
        self._view.close()
        self._database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    # Finished episodes

    def add_episode(self, episode: EpisodeRecord | Episode, agent: str | None = None) -> str:
        """Store a finished episode and return its id; `memory.json` shows it a moment later.

        A record is flown again first, so that nothing is stored that is not so; an `Episode` is taken as it is.

        Args:
            episode: The flight.
            agent: Who flew an `Episode`; a record says so itself.

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
        stored = StoredEpisode.of(new_episode_id(), episode, str(agent))
        with self._database.writing() as connection:
            _insert_episode(connection, stored)
        self._view.refresh()
        return stored.id

    def episode(self, episode_id: str) -> StoredEpisode:
        """The episode of this id.

        Raises:
            UnknownNameError: if there is none; the message lists the newest ids.
            StoreError: if the store cannot be read.
        """
        if episode_id.isascii():
            for _, stored in self._read_episodes("WHERE id = ?", (episode_id,)):
                return stored
        raise UnknownNameError(
            "episode", episode_id, [stored.id for stored in self.latest(3)] or ["none: the store is empty"]
        )

    def latest(self, n: int, task: str | TaskConfig | None = None) -> list[StoredEpisode]:
        """The last `n` finished episodes, of one task or of all, newest first.

        Raises:
            UnknownNameError: if there is no such task.
            InvalidValueError: if n is negative.
            StoreError: if the store cannot be read.
        """
        if n < 0:
            raise InvalidValueError(f"n must be at least 0, got {n}")
        n = min(n, MOST_ROWS)
        if task is None:
            found = self._read_episodes("ORDER BY number DESC LIMIT ?", (n,))
        else:
            known = get_task(task)
            found = self._read_episodes(
                "WHERE task = ? AND task_version = ? ORDER BY number DESC LIMIT ?", (known.id, known.version, n)
            )
        return [stored for _, stored in found]

    def episodes(self) -> Iterator[StoredEpisode]:
        """All finished episodes, oldest first, read as they are asked for.

        Raises:
            StoreError: if the store cannot be read.
        """
        number = 0
        # In pages, since a reader that stays open keeps the log of the file from being folded back.
        while page := self._read_episodes("WHERE number > ? ORDER BY number LIMIT ?", (number, PAGE)):
            yield from (stored for _, stored in page)
            number = page[-1][0]

    def analysis(self, task: str | TaskConfig, last: int = 1000, patience: float = 0.25) -> Analysis:
        """What the last episodes of a task come to.

        The optima that regret needs are solved once per map, in a thread of the store's, and kept; this call waits for
        them for at most `patience` seconds. The maps that are not solved by then are left out of `mean_regret`
        (`regret_episodes` says how many count) and are there in a later call.

        Raises:
            UnknownNameError: if there is no such task.
            InvalidValueError: if `last` is below 1.
            StoreError: if the store cannot be read, or the optima could not be written.
        """
        if last < 1:
            raise InvalidValueError(f"last must be at least 1, got {last}")
        known = get_task(task)
        total, rows = self._finished_rows(known, last)
        unsolved = list(dict.fromkeys(row.seed for row in rows if not row.solved))
        if unsolved:
            self._optima.solve(known, unsolved, patience)
            total, rows = self._finished_rows(known, last)
        return analyse(known.id, total, rows)

    # Sessions

    def open_session(
        self, task: str, task_version: int, seed: int, reward_profile: str, agent: str, capacity: int
    ) -> str:
        """Open a session on a map and return its id, which cannot be guessed.

        Raises:
            CapacityError: if `capacity` sessions are open already; expire the idle ones first.
            UnknownNameError: if there is no such task, version or profile.
            InvalidValueError: if the seed is not in [0, 2^53), or the agent's name is not one printable line.
            StoreError: if it could not be written.
        """
        session_id = secrets.token_urlsafe(24)
        task = known_task(task, task_version, seed, reward_profile)
        now = time.time()
        row = (session_id, task, task_version, seed, reward_profile, check_agent(agent), "", None, now, now)
        with self._database.writing() as connection:
            if _count_sessions(connection) >= capacity:
                raise CapacityError(f"all {capacity} sessions are taken: try again later")
            connection.execute("INSERT INTO sessions VALUES (?,?,?,?,?,?,?,?,?,?)", row)
        return session_id

    @contextmanager
    def session(self, session_id: str) -> Generator[SessionRow, None, None]:
        """A session to be changed. Nobody else writes to the store meanwhile: keep the block short, without `await`.

        At the end of the block its changes and the finished episodes are kept together; if the block raises, nothing is
        kept, and an `Episode` that was stepped inside must be flown anew. Entering counts as use.

            with store.session(id) as row:
                reward = episode.step(action)
                row.append(action)
                if episode.ended:
                    row.finish(episode)

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired.
            StoreError: if the store stays busy for 30 s, cannot be written, or the block is inside another one of the
                same thread.
        """
        with self._database.writing() as connection:
            row = _session_row(connection, session_id)
            yield row
            for stored in row.finished:
                _insert_episode(connection, stored)
            connection.execute(
                "UPDATE sessions SET task = ?, task_version = ?, seed = ?, reward_profile = ?, agent = ?, actions = ?, "
                "episode_id = ?, touched_at = ? WHERE id = ?",
                (
                    row.task,
                    row.task_version,
                    row.seed,
                    row.reward_profile,
                    row.agent,
                    "".join(map(str, row.actions)),
                    row.episode_id,
                    time.time(),
                    session_id,
                ),
            )
        if row.finished:
            self._view.refresh()

    def read_session(self, session_id: str) -> SessionRow:
        """A session as it stands, to be read only; does not wait for writers and does not count as use.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired.
            StoreError: if the store cannot be read.
        """
        with self._database.reading() as connection:
            return _session_row(connection, session_id)

    def end_session(self, session_id: str) -> None:
        """End a session: from now on it is gone.

        Raises:
            NoSessionError: if there never was such a session.
            SessionGoneError: if it has ended or expired already.
            StoreError: if it could not be written.
        """
        with self._database.writing() as connection:
            _session_row(connection, session_id)
            _end_session(connection, session_id)

    def expire_sessions(self, idle_seconds: float) -> list[str]:
        """End the sessions that were not used for so long, and return their ids.

        They are remembered as gone for a week.

        Raises:
            StoreError: if it could not be written.
        """
        now = time.time()
        with self._database.writing() as connection:
            idle = connection.execute("SELECT id FROM sessions WHERE touched_at <= ?", (now - idle_seconds,)).fetchall()
            for (session_id,) in idle:
                _end_session(connection, session_id)
            connection.execute("DELETE FROM gone_sessions WHERE gone_at < ?", (now - GONE_SECONDS,))
        return [session_id for (session_id,) in idle]

    def count_sessions(self) -> int:
        """How many sessions are open.

        Raises:
            StoreError: if the store cannot be read.
        """
        with self._database.reading() as connection:
            return _count_sessions(connection)

    def _read_episodes(self, where: str, values: tuple[object, ...]) -> list[tuple[int, StoredEpisode]]:
        with self._database.reading() as connection:
            rows = connection.execute(
                "SELECT number, id, finished_at, steps, deliveries_total, reward_total, outcome, record "
                f"FROM episodes {where}",
                values,
            ).fetchall()
        return [
            (
                number,
                StoredEpisode(
                    id=episode_id,
                    finished_at=_utc(finished_at),
                    steps=steps,
                    deliveries_total=deliveries_total,
                    reward_total=reward_total,
                    outcome=outcome,
                    record=parse_record(record, f"episode {episode_id} of {self._database.path}"),
                ),
            )
            for number, episode_id, finished_at, steps, deliveries_total, reward_total, outcome, record in rows
        ]

    def _finished_rows(self, task: TaskConfig, last: int) -> tuple[int, list[FinishedRow]]:
        with self._database.reading() as connection:
            (total,) = connection.execute(
                "SELECT count(*) FROM episodes WHERE task = ? AND task_version = ?", (task.id, task.version)
            ).fetchone()
            rows = connection.execute(
                "SELECT e.reward_total, e.score, e.steps, e.deliveries, e.outcome, e.actions, o.task IS NOT NULL, "
                "o.score, e.seed FROM episodes e LEFT JOIN optima o USING (task, task_version, seed) "
                "WHERE e.task = ? AND e.task_version = ? ORDER BY e.number DESC LIMIT ?",
                (task.id, task.version, min(last, MOST_ROWS)),
            ).fetchall()
        # Another process may have stored some between the two.
        return max(total, len(rows)), [FinishedRow(*row) for row in rows]

    def _newer(self, after: int, n: int) -> list[tuple[int, StoredEpisode]]:
        return self._read_episodes("WHERE number > ? ORDER BY number DESC LIMIT ?", (after, n))[::-1]


def _insert_episode(connection: sqlite3.Connection, stored: StoredEpisode) -> None:
    record = stored.record
    connection.execute(
        "INSERT INTO episodes (id, finished_at, task, task_version, seed, reward_profile, agent, actions, deliveries, "
        "deliveries_total, steps, reward_total, score, outcome, record) VALUES (?,?,?,?,?,?,?,?,?,?,?,?,?,?,?)",
        (
            stored.id,
            stored.finished_at.timestamp(),
            record.task,
            record.task_version,
            record.seed,
            record.reward_profile,
            record.agent,
            "".join([DIGITS[name] for name in record.actions]),
            record.deliveries,
            stored.deliveries_total,
            stored.steps,
            stored.reward_total,
            record.score,
            stored.outcome,
            record.to_json(),
        ),
    )


def _session_row(connection: sqlite3.Connection, session_id: str) -> SessionRow:
    # What is not ASCII cannot be an id, and may be no text for SQLite either.
    known = session_id if session_id.isascii() else ""
    found = connection.execute(
        "SELECT task, task_version, seed, reward_profile, agent, actions, episode_id, opened_at, touched_at "
        "FROM sessions WHERE id = ?",
        (known,),
    ).fetchone()
    if found is None:
        if connection.execute("SELECT 1 FROM gone_sessions WHERE id = ?", (known,)).fetchone():
            raise SessionGoneError("this session has ended or was idle for too long: open a new one")
        raise NoSessionError("there is no such session: open one first")
    task, task_version, seed, reward_profile, agent, actions, episode_id, opened_at, touched_at = found
    return SessionRow(
        id=session_id,
        task=task,
        task_version=task_version,
        seed=seed,
        reward_profile=reward_profile,
        agent=agent,
        actions=tuple(map(int, actions)),
        episode_id=episode_id,
        opened_at=_utc(opened_at),
        touched_at=_utc(touched_at),
    )


def _end_session(connection: sqlite3.Connection, session_id: str) -> None:
    connection.execute("DELETE FROM sessions WHERE id = ?", (session_id,))
    connection.execute("INSERT OR REPLACE INTO gone_sessions VALUES (?, ?)", (session_id, time.time()))


def _count_sessions(connection: sqlite3.Connection) -> int:
    return connection.execute("SELECT count(*) FROM sessions").fetchone()[0]


def _utc(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, timezone.utc)
