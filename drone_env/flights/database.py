"""The SQLite file of the store: its tables, and one connection each to read and to write."""

import os
import sqlite3
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic, sleep
from typing import TypeVar

from drone_env.errors import StoreError

BUSY_SECONDS = 30.0
"""Maximum time to wait for other writers."""
RETRY_SECONDS = 0.002
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
    parent TEXT,
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
CREATE TABLE IF NOT EXISTS own_tasks (
    task TEXT NOT NULL,
    task_version INTEGER NOT NULL,
    rules TEXT NOT NULL,
    PRIMARY KEY (task, task_version)
) WITHOUT ROWID;
PRAGMA user_version = {VERSION};
COMMIT;
"""
"""A row of `flights` is a `Flight`; the columns from `agent` on are computed from it.

`agent` is the label of its provenance. `revision` counts the changes of an unfinished flight. `number` is the order of
storing finished flights; it and the columns after it are null before the end. An unfinished flight belongs to one
session and goes with it. `optima.score` is null if the map is too large to be solved. `sessions.touched_at` is on the
monotonic clock. `sessions.address` is the address whose callers share the session because they name none; it is null
after somebody has named the session. `sessions.owner` is the address that opened it, for its share. `own_tasks`
contains a digest of each task that is not one of the package's, since another task may be registered under its name
later.
"""


Result = TypeVar("Result")


class BusyError(StoreError):
    """Somebody else is writing."""


class Database:
    """One connection to write and one to read, each for one thread at a time, so a long read does not block a writer.

    Args:
        path: The file.

    Raises:
        OSError: if the file cannot be created.
        StoreError: if it is not a store of this version, or cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.failed = False
        """Whether the last write has failed."""
        self._waits = True
        """Whether the thread that writes waits for other processes."""
        # Session ids are secrets; SQLite gives its other files the same permissions.
        path.touch(mode=0o600)
        self._opened = path.stat()
        # A thread that begins a second transaction gets an error of SQLite instead of a deadlock.
        self.lock = threading.RLock()
        """Held by the thread that writes."""
        self._read_lock = threading.Lock()
        try:
            self._writer = self._connect()
            self._reader = self._connect()
            self._writer.execute("PRAGMA busy_timeout = 0")
        except sqlite3.Error as error:
            raise self._error(error) from error

    def check(self) -> None:
        """Check that the file is still the opened one: what is written to a deleted file is lost.

        Raises:
            StoreError: if it is not.
        """
        with suppress(FileNotFoundError):
            if os.path.samestat(os.stat(self.path), self._opened):
                return
        raise StoreError(f"store {self.path} was deleted, moved or replaced while in use: start the server again")

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        with self.lock, self._read_lock:
            self._reader.close()
            self._writer.close()

    @contextmanager
    def reading(self) -> Generator[sqlite3.Connection, None, None]:
        """Yield the connection to read from; each statement sees all finished transactions.

        Raises:
            StoreError: if a statement fails.
        """
        try:
            with self._read_lock:
                yield self._reader
        except sqlite3.Error as error:
            raise self._error(error) from error

    @contextmanager
    def writing(self) -> Generator[sqlite3.Connection, None, None]:
        """Yield the connection to write to, in a transaction that is committed unless the block raises.

        Raises:
            StoreError: if a statement fails, the file stays busy or is gone, or this thread is already in such a block.
        """
        with self.lock:
            self.check()
            try:
                self._insist(self._writer, "BEGIN IMMEDIATE")
                with self._writer:
                    yield self._writer
            except sqlite3.Error as error:
                self.failed = True
                raise self._error(error) from error
            self.failed = False

    def at_once(self, function: Callable[[], Result]) -> Result:
        """Call a function that writes, but not if it would have to wait for another writer.

        Raises:
            BusyError: if it would.
        """
        if not self.lock.acquire(blocking=False):
            raise BusyError("another thread is writing")
        self._waits = False
        try:
            return function()
        finally:
            self._waits = True
            self.lock.release()

    def leave_checkpoints(self) -> None:
        """Leave checkpoints, which wait for the disk, to calls of `checkpoint`."""
        self._writer.execute("PRAGMA wal_autocheckpoint = 0")

    def checkpoint(self) -> None:
        """Move the finished transactions from SQLite's log to the file; writers do not wait meanwhile.

        Raises:
            StoreError: if it fails.
        """
        with self.reading() as connection:
            connection.execute("PRAGMA wal_checkpoint").fetchall()

    def _insist(self, connection: sqlite3.Connection, statement: str) -> None:
        """Execute a statement that SQLite refuses while others write, until it succeeds or `BUSY_SECONDS` are over."""
        # After a failure nobody waits, so that all who wait for it fail together.
        until = monotonic() + (0 if self.failed else BUSY_SECONDS)
        while True:
            try:
                connection.execute(statement)
                return
            except sqlite3.OperationalError as error:
                if "is locked" not in str(error):
                    raise
                if not self._waits:
                    raise BusyError("another process is writing") from error
                if monotonic() >= until:
                    raise
            sleep(RETRY_SECONDS)

    def _connect(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self.path, timeout=BUSY_SECONDS, isolation_level=None, check_same_thread=False)
        connection.row_factory = sqlite3.Row
        try:
            # If two change the mode at once, SQLite refuses one without waiting: each holds what the other waits for.
            self._insist(connection, "PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = NORMAL")
            version = connection.execute("PRAGMA user_version").fetchone()[0]
            if version not in (0, VERSION):
                reads = f"this drone-env reads version {VERSION}: use another data folder"
                raise StoreError(f"{self.path} has version {version}, {reads}")
            if not version:
                connection.executescript(SCHEMA)
        except BaseException:
            connection.close()
            raise
        return connection

    def _error(self, error: sqlite3.Error) -> StoreError:
        return StoreError(f"store {self.path}: {error}")
