"""The SQLite file of the store: its tables, and who may read and write when."""

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
PARTS = ("", "-wal", "-shm")
"""What SQLite adds to the name of the file: all three hold what has been written."""
APPLICATION_ID = 0x44726F6E
"""Marks an SQLite file as a store of this package."""

VERSION = 1
SCHEMA = """
CREATE TABLE episodes (
    number INTEGER PRIMARY KEY AUTOINCREMENT,
    id TEXT NOT NULL UNIQUE,
    finished_at REAL NOT NULL,
    task TEXT NOT NULL,
    task_version INTEGER NOT NULL,
    seed INTEGER NOT NULL,
    reward_profile TEXT NOT NULL,
    agent TEXT NOT NULL,
    actions TEXT NOT NULL,
    deliveries INTEGER NOT NULL,
    deliveries_total INTEGER NOT NULL,
    steps INTEGER NOT NULL,
    reward_total REAL NOT NULL,
    score REAL NOT NULL,
    outcome TEXT NOT NULL,
    record TEXT NOT NULL
);
CREATE INDEX episodes_by_task ON episodes (task, task_version, number);
CREATE TABLE optima (
    task TEXT NOT NULL,
    task_version INTEGER NOT NULL,
    seed INTEGER NOT NULL,
    score REAL,
    PRIMARY KEY (task, task_version, seed)
) WITHOUT ROWID;
CREATE TABLE sessions (
    id TEXT NOT NULL PRIMARY KEY,
    task TEXT NOT NULL,
    task_version INTEGER NOT NULL,
    seed INTEGER NOT NULL,
    reward_profile TEXT NOT NULL,
    agent TEXT NOT NULL,
    actions TEXT NOT NULL,
    episode_id TEXT,
    opened_at REAL NOT NULL,
    touched_at REAL NOT NULL,
    address TEXT
) WITHOUT ROWID;
CREATE TABLE gone_sessions (
    id TEXT NOT NULL PRIMARY KEY,
    gone_at REAL NOT NULL
) WITHOUT ROWID;
CREATE INDEX sessions_by_use ON sessions (touched_at);
CREATE INDEX finished_sessions_by_use ON sessions (touched_at) WHERE episode_id IS NOT NULL;
CREATE INDEX gone_sessions_by_time ON gone_sessions (gone_at);
CREATE UNIQUE INDEX unnamed_sessions ON sessions (address) WHERE address IS NOT NULL;
CREATE TABLE own_tasks (
    task TEXT NOT NULL,
    task_version INTEGER NOT NULL,
    rules TEXT NOT NULL,
    PRIMARY KEY (task, task_version)
) WITHOUT ROWID;
"""
"""`episodes.number` is the order of storing, and rises forever; `record` is the flight as JSON, and the columns beside
it are for queries. `optima.score` is null if the map is too large to be solved. `sessions.address` is that of a caller
who has opened a session without naming one, until somebody names it. `own_tasks` tells which task the rows mean if it
is none of the package's: another may be registered by its name later.
"""


class Database:
    """One connection to write and one to read, each for one thread at a time, so that a long read holds up no writer.

    Args:
        path: The file.
        busy_seconds: For how long to wait while others write.

    Raises:
        OSError: if the file cannot be made.
        StoreError: if it is no store of this version, or cannot be opened.
    """

    def __init__(self, path: Path, busy_seconds: float = BUSY_SECONDS) -> None:
        self.path = path
        self._busy_seconds = busy_seconds
        # Session ids are secrets; SQLite gives the files beside this one the same permissions.
        path.touch(mode=0o600)
        # A thread inside a transaction that begins another gets the error of SQLite, instead of waiting for itself.
        self._write_lock = threading.RLock()
        self._read_lock = threading.Lock()
        with self._errors():
            # Writers poll by themselves: SQLite's own waiting grows to 100 ms, a transaction here lasts 0.1 ms.
            self._writer = self._connect(0)
            try:
                self._reader = self._connect(busy_seconds)
            except BaseException:
                self._writer.close()
                raise
        self._parts = {part: _identity(part) for part in (f"{path}{added}" for added in PARTS)}

    def check(self) -> None:
        """See whether the files are still where they were opened: what is written into others is lost.

        Raises:
            StoreError: if they are not.
        """
        for part, opened in self._parts.items():
            if _identity(part) != opened:
                raise StoreError(
                    f"store {self.path}: {part} was deleted, moved or replaced while it was in use: "
                    "nothing more is kept until it is back, or the server is started again"
                )

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        with self._write_lock, self._read_lock:
            self._reader.close()
            self._writer.close()

    @contextmanager
    def reading(self) -> Generator[sqlite3.Connection, None, None]:
        """The connection to read from; every statement sees what is kept by then.

        Raises:
            StoreError: if a statement fails.
        """
        with self._errors(), self._read_lock:
            yield self._reader

    @contextmanager
    def writing(self) -> Generator[sqlite3.Connection, None, None]:
        """The connection to write to, in a transaction that is kept if the block ends well.

        Raises:
            StoreError: if a statement fails, the file stays busy or is gone, or this thread is inside such a block
                already.
        """
        with self._errors(), self._write_lock:
            self._when_free(lambda: self._writer.execute("BEGIN IMMEDIATE"))
            with self._writer:
                yield self._writer
                self.check()

    def check_task(self, connection: sqlite3.Connection, task: TaskConfig, claim: bool = False) -> None:
        """See that what is kept under the name of a task is of this task.

        Args:
            connection: This file's.
            task: The task.
            claim: Whether something of it is to be kept: its name then means this task alone from now on.

        Raises:
            StoreError: if it is of another.
        """
        if task.id in PACKAGE_TASKS:
            return
        name = (task.id, task.version)
        kept = connection.execute("SELECT rules FROM own_tasks WHERE task = ? AND task_version = ?", name).fetchone()
        if kept is None and claim:
            connection.execute("INSERT INTO own_tasks VALUES (?, ?, ?)", (*name, task.digest))
        elif kept not in (None, (task.digest,)):
            raise StoreError(
                f"store {self.path} keeps flights of another task {task.id!r} (rules {kept[0]}, now {task.digest}): a "
                "city or task that is changed takes another name, or another data folder"
            )

    def _connect(self, busy_seconds: float) -> sqlite3.Connection:
        connection = sqlite3.connect(self.path, timeout=busy_seconds, isolation_level=None, check_same_thread=False)
        try:
            self._when_free(lambda: _make_tables(connection, self.path))
            self._when_free(lambda: connection.execute("PRAGMA journal_mode = WAL").fetchone())
            connection.execute("PRAGMA synchronous = NORMAL")
        except BaseException:
            connection.close()
            raise
        return connection

    @contextmanager
    def _errors(self) -> Generator[None, None, None]:
        try:
            yield
        except sqlite3.Error as error:
            raise StoreError(f"store {self.path}: {error}") from error

    def _when_free(self, operation: Callable[[], object]) -> None:
        """Do it as soon as no other process is writing, unless that takes too long."""
        deadline = time.monotonic() + self._busy_seconds
        while True:
            try:
                operation()
                return
            except sqlite3.OperationalError as error:
                # Python 3.10 does not tell the error code.
                if "locked" not in str(error) or time.monotonic() > deadline:
                    raise
            time.sleep(POLL_SECONDS)


def _make_tables(connection: sqlite3.Connection, path: Path) -> None:
    """Make the tables of a new file, in one transaction; several processes may try at once."""
    if _has_tables(connection, path):
        return
    with connection:
        connection.execute("BEGIN IMMEDIATE")
        if not _has_tables(connection, path):  # another process may have been faster
            for statement in SCHEMA.split(";"):
                connection.execute(statement)
            connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            connection.execute(f"PRAGMA user_version = {VERSION}")


def _has_tables(connection: sqlite3.Connection, path: Path) -> bool:
    """Whether a file is a store; False for an empty one.

    Raises:
        StoreError: if it is of another program or another version.
    """
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if not version and not connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
        return False
    if connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
        raise StoreError(f"{path} is an SQLite file of another program")
    if version != VERSION:
        raise StoreError(
            f"{path} has version {version}, this drone-env reads version {VERSION}: use another data folder"
        )
    return True


def _identity(path: str) -> tuple[int, int] | None:
    """Which file is at a path; None where none can be found."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino
