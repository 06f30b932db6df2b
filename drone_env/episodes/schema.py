"""The tables of the store, and how a file of an earlier version gets them."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path

from drone_env.errors import StoreError

APPLICATION_ID = 0x44726F6E
"""Marks an SQLite file as a store of this package."""

MIGRATIONS: tuple[str, ...] = (
    # 1. `record` is the flight as JSON, of whatever format version it was written in (a new one needs a new version
    # here, too, so that older packages refuse the file); the columns beside it are what analyses need. `number` is the
    # order of storing, and rises for ever. `optima.score` is null where the map is too large to be solved.
    """
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
        touched_at REAL NOT NULL
    ) WITHOUT ROWID;
    CREATE TABLE gone_sessions (
        id TEXT NOT NULL PRIMARY KEY,
        gone_at REAL NOT NULL
    ) WITHOUT ROWID;
    """,
    # 2. Who opens a session counts all, and looks for idle ones and finished ones while nobody else writes.
    """
    CREATE INDEX sessions_by_use ON sessions (touched_at);
    CREATE INDEX finished_sessions_by_use ON sessions (touched_at) WHERE episode_id IS NOT NULL;
    CREATE INDEX gone_sessions_by_time ON gone_sessions (gone_at);
    """,
    # 3. `address` is that of the caller who has opened a session without naming one, until somebody names it.
    """
    ALTER TABLE sessions ADD COLUMN address TEXT;
    CREATE UNIQUE INDEX unnamed_sessions ON sessions (address) WHERE address IS NOT NULL;
    """,
)


def migrate(connection: sqlite3.Connection, path: Path, migrations: Sequence[str] = MIGRATIONS) -> None:
    """Bring a file to the last version, in one transaction; several processes may try at once.

    Args:
        connection: In autocommit mode, without an open transaction.
        path: What the errors call the file.
        migrations: Scripts that lead from each version to the next; version 0 is an empty file.

    Raises:
        StoreError: if the file is not a store, or is newer than the migrations.
        sqlite3.Error: if it cannot be read or written.
    """
    if _version(connection, path, len(migrations)) == len(migrations):
        return
    connection.execute("BEGIN IMMEDIATE")
    try:
        # Another process may have been faster.
        version = _version(connection, path, len(migrations))
        for script in migrations[version:]:
            for statement in script.split(";"):
                connection.execute(statement)
        connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        connection.execute(f"PRAGMA user_version = {len(migrations)}")
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise


def _version(connection: sqlite3.Connection, path: Path, newest: int) -> int:
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    tables = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
    if (version or tables) and connection.execute("PRAGMA application_id").fetchone()[0] != APPLICATION_ID:
        raise StoreError(f"{path} is an SQLite file of another program")
    if version > newest:
        raise StoreError(
            f"{path} has version {version}, this drone-env knows {newest} and older: update it, or use another folder"
        )
    return version
