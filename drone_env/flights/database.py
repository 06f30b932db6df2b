"""The SQLite file of the store: its tables, and one connection each to read and to write."""

import os
import sqlite3
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

from drone_env.core.tasks import PACKAGE_TASKS, TaskConfig
from drone_env.errors import StoreError

BUSY_SECONDS = 30.0
POLL_SECONDS = 0.0005
SUFFIXES = ("", "-wal", "-shm")
"""Suffixes of the three files that SQLite writes."""
APPLICATION_ID = 0x44726F6E
"""Marks an SQLite file as a store of this package."""

VERSION = 1
SCHEMA = f"""
BEGIN IMMEDIATE;
CREATE TABLE IF NOT EXISTS flights (
    id TEXT NOT NULL UNIQUE,
    task TEXT NOT NULL,
    task_version INTEGER NOT NULL,
    seed INTEGER NOT NULL,
    reward_profile TEXT NOT NULL,
    actions TEXT NOT NULL,
    pilot TEXT NOT NULL,
    person TEXT,
    values_used INTEGER NOT NULL,
    undo_used INTEGER NOT NULL,
    parent_id TEXT,
    parent_step INTEGER,
    agent TEXT NOT NULL,
    revision INTEGER NOT NULL DEFAULT 0,
    number INTEGER,
    finished_at REAL,
    deliveries INTEGER,
    deliveries_total INTEGER,
    steps INTEGER,
    reward_total REAL,
    score REAL,
    outcome TEXT
);
CREATE UNIQUE INDEX IF NOT EXISTS flights_by_number ON flights (number) WHERE number IS NOT NULL;
CREATE INDEX IF NOT EXISTS flights_by_task ON flights (task, task_version, number) WHERE number IS NOT NULL;
CREATE INDEX IF NOT EXISTS flights_by_map ON flights (task, task_version, seed);
CREATE INDEX IF NOT EXISTS flights_by_parent ON flights (parent_id) WHERE parent_id IS NOT NULL;
CREATE TABLE IF NOT EXISTS optima (
    task TEXT NOT NULL,
    task_version INTEGER NOT NULL,
    seed INTEGER NOT NULL,
    score REAL,
    PRIMARY KEY (task, task_version, seed)
) WITHOUT ROWID;
CREATE TABLE IF NOT EXISTS sessions (
    id TEXT NOT NULL PRIMARY KEY,
    flight_id TEXT NOT NULL,
    touched_at REAL NOT NULL,
    address TEXT,
    owner TEXT NOT NULL
) WITHOUT ROWID;
CREATE UNIQUE INDEX IF NOT EXISTS unnamed_sessions ON sessions (address) WHERE address IS NOT NULL;
CREATE TRIGGER IF NOT EXISTS session_ended AFTER DELETE ON sessions BEGIN
    DELETE FROM flights WHERE id = OLD.flight_id AND number IS NULL;
END;
CREATE TRIGGER IF NOT EXISTS flight_left AFTER UPDATE OF flight_id ON sessions
WHEN OLD.flight_id != NEW.flight_id BEGIN
    DELETE FROM flights WHERE id = OLD.flight_id AND number IS NULL;
END;
CREATE TRIGGER IF NOT EXISTS parent_left AFTER DELETE ON flights WHEN OLD.parent_id IS NOT NULL BEGIN
    DELETE FROM flights WHERE id = OLD.parent_id AND number IS NULL
        AND NOT EXISTS (SELECT 1 FROM flights WHERE parent_id = OLD.parent_id);
END;
CREATE TABLE IF NOT EXISTS own_tasks (
    task TEXT NOT NULL,
    task_version INTEGER NOT NULL,
    rules TEXT NOT NULL,
    PRIMARY KEY (task, task_version)
) WITHOUT ROWID;
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {VERSION};
COMMIT;
"""
"""A row of `flights` is a `Flight`; the columns from `agent` on are computed from it.

`agent` is the label of its provenance. `revision` counts the changes of an unfinished flight. `number` is the order of
storing finished flights; it and the columns after it are null before the end. An unfinished flight belongs to one
session, or is the parent of a fork; otherwise the triggers delete it. `optima.score` is null if the map is too large to
be solved. `sessions.touched_at` is on the monotonic clock. `sessions.address` is the address whose callers share the
session because they name none; it is null after somebody has named the session. `sessions.owner` is the address that
opened it, for its share. `own_tasks` contains a digest of each task that is not one of the package's, since another
task may be registered under its name later.
"""


class Database:
    """One connection to write and one to read, each for one thread at a time, so a long read does not block a writer.

    Args:
        path: The file.
        busy_seconds: Maximum time to wait for other writers.

    Raises:
        OSError: if the file cannot be created.
        StoreError: if it is not a store of this version, or cannot be opened.
    """

    def __init__(self, path: Path, busy_seconds: float = BUSY_SECONDS) -> None:
        self.path = path
        self.failed = False
        """Whether a write has failed since the last `probe`."""
        self._busy_seconds = busy_seconds
        self._gave_up = False
        # Session ids are secrets; SQLite gives its other files the same permissions.
        path.touch(mode=0o600)
        # A thread that begins a second transaction gets an error of SQLite instead of a deadlock.
        self._write_lock = threading.RLock()
        self._read_lock = threading.Lock()
        with self._errors():
            # Writers poll: SQLite would sleep up to 100 ms, and a transaction lasts 0.1 ms.
            self._writer = self._connect(0)
            try:
                self._reader = self._connect(busy_seconds)
            except BaseException:
                self._writer.close()
                raise
        self._files = {file: _identity(file) for file in (f"{path}{suffix}" for suffix in SUFFIXES)}

    def check(self) -> None:
        """Check that the files are still the opened ones: writes to deleted files are lost.

        Raises:
            StoreError: if they are not.
        """
        for file, opened in self._files.items():
            if _identity(file) != opened:
                raise StoreError(
                    f"store {self.path}: {file} was deleted, moved or replaced while it was in use: "
                    "put it back, or start the server again"
                )

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        with self._write_lock, self._read_lock:
            self._reader.close()
            self._writer.close()

    @contextmanager
    def reading(self) -> Generator[sqlite3.Connection, None, None]:
        """Yield the connection to read from; each statement sees all finished transactions.

        Raises:
            StoreError: if a statement fails.
        """
        with self._errors(), self._read_lock:
            yield self._reader

    @contextmanager
    def writing(self) -> Generator[sqlite3.Connection, None, None]:
        """Yield the connection to write to, in a transaction that is committed unless the block raises.

        Raises:
            StoreError: if a statement fails, the file stays busy or is gone, or this thread is already in such a block.
        """
        with self._errors(), self._write_lock:
            try:
                self._when_free(lambda: self._writer.execute("BEGIN IMMEDIATE"))
                with self._writer:
                    yield self._writer
                    self.check()
            except sqlite3.Error:
                self.failed = True
                raise

    def probe(self) -> None:
        """Write something if a write has failed, to see whether the disk has room again.

        Raises:
            StoreError: if this write fails, too.
        """
        if self.failed:
            with self.writing() as connection:
                connection.execute(f"PRAGMA user_version = {VERSION}")
            self.failed = False

    def check_task(self, connection: sqlite3.Connection, task: TaskConfig, claim: bool = False) -> None:
        """Check that the rows under the name of a task belong to this task.

        Args:
            connection: A connection to this file.
            task: The task.
            claim: Whether to bind the name to this task, before its first row is written.

        Raises:
            StoreError: if they belong to another task of the same name.
        """
        if task.id in PACKAGE_TASKS:
            return
        name = (task.id, task.version)
        if claim:
            connection.execute("INSERT OR IGNORE INTO own_tasks VALUES (?, ?, ?)", (*name, task.digest))
        query = "SELECT rules FROM own_tasks WHERE task = ? AND task_version = ? AND rules != ?"
        for (rules,) in connection.execute(query, (*name, task.digest)):
            raise StoreError(
                f"store {self.path} has flights of another task {task.id!r} (rules {rules}, now {task.digest}): "
                "rename the changed task, or use another data folder"
            )

    def _connect(self, busy_seconds: float) -> sqlite3.Connection:
        connection = sqlite3.connect(self.path, timeout=busy_seconds, isolation_level=None, check_same_thread=False)
        connection.row_factory = sqlite3.Row
        try:
            self._when_free(lambda: _make_tables(connection, self.path))
            self._when_free(lambda: connection.execute("PRAGMA journal_mode = WAL").fetchone())
            connection.execute("PRAGMA synchronous = NORMAL")
            connection.execute("PRAGMA recursive_triggers = ON")
        except BaseException:
            connection.close()
            raise
        return connection

    @contextmanager
    def _errors(self) -> Generator[None, None, None]:
        try:
            yield
        except sqlite3.Error as error:
            damaged = any(words in str(error) for words in ("malformed", "not a database", "no such"))
            remedy = ": move the file away, or use another data folder" if damaged else ""
            raise StoreError(f"store {self.path}: {error}{remedy}") from error

    def _when_free(self, operation: Callable[[], object]) -> None:
        """Run an operation once no other process writes, and give up after `busy_seconds`.

        Until the next success nobody else waits, so that all who wait in a queue fail together.
        """
        deadline = time.monotonic() + (0 if self._gave_up else self._busy_seconds)
        while True:
            try:
                operation()
                self._gave_up = False
                return
            except sqlite3.OperationalError as error:
                # Python 3.10 has no error code.
                if "locked" not in str(error):
                    raise
                if time.monotonic() > deadline:
                    self._gave_up = True
                    raise
            time.sleep(POLL_SECONDS)


def _make_tables(connection: sqlite3.Connection, path: Path) -> None:
    """Create the tables of an empty file in one transaction; several processes may do so at once.

    Raises:
        StoreError: if the file belongs to another program or another version.
    """
    connection.rollback()  # a commit that a reader has delayed leaves the transaction open
    tables = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if not version and not tables:
        connection.executescript(SCHEMA)
    elif connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
        raise StoreError(f"{path} is an SQLite file of another program")
    elif version != VERSION:
        raise StoreError(
            f"{path} has version {version}, this drone-env reads version {VERSION}: use another data folder"
        )


def _identity(path: str) -> tuple[int, int] | None:
    """Return device and inode of the file at a path; None if there is none."""
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_dev, status.st_ino
