"""The rows of the store's tables, inside a transaction that the store has begun."""

import sqlite3
from datetime import datetime, timezone
from typing import Any, NamedTuple

from drone_env.core.actions import Action
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.episodes.finished import StoredEpisode
from drone_env.episodes.record import parse_record
from drone_env.episodes.sessions import SessionRow
from drone_env.episodes.statistics import FinishedRow
from drone_env.errors import NoSessionError, SessionGoneError

FINISHED_SECONDS = 30.0
"""For so long a finished session keeps its place even where others have none: its owner still asks for the score."""
CHARACTERS = bytes.maketrans(bytes(range(10)), b"0123456789")
NUMBERS = bytes.maketrans(b"0123456789", bytes(range(10)))
"""Actions are kept as a text of digits; these turn bytes with their numbers into it, and back."""
DIGITS = {action.name: str(int(action)) for action in Action}


class ListedEpisode(NamedTuple):
    """A finished episode among others."""

    number: int
    """The order of storing; it rises for ever."""
    episode: StoredEpisode
    solved: bool
    """Whether its map has been given to the solver."""
    optimum: float | None
    """The optimum of its map, None while it is not known, the task is not registered, or the map is too large."""


def episode_rows(connection: sqlite3.Connection, where: str, values: tuple[object, ...]) -> list[Any]:
    """Rows of finished episodes, for `listed_episode` once the transaction is over."""
    return connection.execute(
        "SELECT number, id, finished_at, steps, deliveries_total, reward_total, outcome, record, o.task IS NOT NULL, "
        f"o.score FROM episodes LEFT JOIN optima o USING (task, task_version, seed) {where}",
        values,
    ).fetchall()


def selection(
    task: str | TaskConfig | None,
    agent: str | None = None,
    before: int | None = None,
    after: int | None = None,
    episode_id: str | None = None,
) -> tuple[str, tuple[object, ...]]:
    """The WHERE of `episode_rows`, and its values.

    Raises:
        UnknownNameError: if there is no such task.
    """
    known = None if task is None else get_task(task)
    conditions = [
        (value, condition)
        for value, condition in (
            (None if known is None else known.id, "task = ?"),
            (None if known is None else known.version, "task_version = ?"),
            (agent, "agent = ?"),
            (before, "number < ?"),
            (after, "number > ?"),
            (episode_id, "id = ?"),
        )
        if value is not None
    ]
    where = " AND ".join(condition for _, condition in conditions)
    return f"WHERE {where}" if where else "", tuple(value for value, _ in conditions)


def listed_episode(row: Any, name: str) -> ListedEpisode:
    """The episode of a row.

    Args:
        row: One of `episode_rows`.
        name: What an error calls it.

    Raises:
        InvalidValueError: if its record cannot be read.
    """
    number, episode_id, finished_at, steps, deliveries_total, reward_total, outcome, record, solved, optimum = row
    stored = StoredEpisode(
        id=episode_id,
        finished_at=_utc(finished_at),
        steps=steps,
        deliveries_total=deliveries_total,
        reward_total=reward_total,
        outcome=outcome,
        record=parse_record(record, name),
    )
    return ListedEpisode(number, stored, bool(solved), optimum)


def finished_rows(connection: sqlite3.Connection, task: TaskConfig, last: int) -> tuple[int, list[FinishedRow]]:
    """How many episodes of a task there are, and the last of them, newest first."""
    (total,) = connection.execute(
        "SELECT count(*) FROM episodes WHERE task = ? AND task_version = ?", (task.id, task.version)
    ).fetchone()
    rows = connection.execute(
        "SELECT e.reward_total, e.score, e.steps, e.deliveries, e.outcome, e.actions, o.task IS NOT NULL, "
        "o.score, e.seed FROM episodes e LEFT JOIN optima o USING (task, task_version, seed) "
        "WHERE e.task = ? AND e.task_version = ? ORDER BY e.number DESC LIMIT ?",
        (task.id, task.version, last),
    ).fetchall()
    # Another process may have stored some between the two.
    return max(total, len(rows)), [FinishedRow(*row) for row in rows]


def insert_episode(connection: sqlite3.Connection, stored: StoredEpisode) -> None:
    """Add a finished episode."""
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


def session_row(connection: sqlite3.Connection, session_id: str) -> SessionRow:
    """A session.

    Raises:
        NoSessionError: if there never was such a session.
        SessionGoneError: if it has ended or expired.
    """
    # What is not ASCII cannot be an id, and may be no text for SQLite either.
    known = session_id if session_id.isascii() else ""
    found = connection.execute(
        "SELECT task, task_version, seed, reward_profile, agent, actions, episode_id, opened_at, touched_at, "
        "address FROM sessions WHERE id = ?",
        (known,),
    ).fetchone()
    if found is None:
        if connection.execute("SELECT 1 FROM gone_sessions WHERE id = ?", (known,)).fetchone():
            raise SessionGoneError("this session has ended or was idle for too long: open a new one")
        raise NoSessionError("there is no such session: open one first")
    task, task_version, seed, reward_profile, agent, actions, episode_id, opened_at, touched_at, address = found
    return SessionRow(
        id=session_id,
        task=task,
        task_version=task_version,
        seed=seed,
        reward_profile=reward_profile,
        agent=agent,
        actions=tuple(actions.encode().translate(NUMBERS)),
        episode_id=episode_id,
        opened_at=_utc(opened_at),
        touched_at=_utc(touched_at),
        address=address,
    )


def unnamed_session(connection: sqlite3.Connection, address: str) -> str | None:
    """The session of those at an address who name none: the one that they opened last, unless somebody named it."""
    found = connection.execute("SELECT id FROM sessions WHERE address = ?", (address,)).fetchone()
    return None if found is None else found[0]


def update_session(connection: sqlite3.Connection, session_id: str, row: SessionRow, now: float) -> None:
    """Write a session as it stands, used just now."""
    connection.execute(
        "UPDATE sessions SET task = ?, task_version = ?, seed = ?, reward_profile = ?, agent = ?, actions = ?, "
        "episode_id = ?, touched_at = ?, address = ? WHERE id = ?",
        (
            *(row.task, row.task_version, row.seed, row.reward_profile, row.agent),
            *(bytes(row.actions).translate(CHARACTERS).decode(), row.episode_id, now, row.address, session_id),
        ),
    )


def end_session(connection: sqlite3.Connection, session_id: str, now: float) -> None:
    """Take a session out, and remember since when it is gone."""
    connection.execute("DELETE FROM sessions WHERE id = ?", (session_id,))
    connection.execute("INSERT OR REPLACE INTO gone_sessions VALUES (?, ?)", (session_id, now))


def end_finished(connection: sqlite3.Connection, now: float) -> bool:
    """End the finished session that was not used for longest, if it may give way by now; whether there was one."""
    found = connection.execute(
        "SELECT id FROM sessions WHERE episode_id IS NOT NULL AND touched_at <= ? ORDER BY touched_at LIMIT 1",
        (now - FINISHED_SECONDS,),
    ).fetchone()
    if found is not None:
        end_session(connection, found[0], now)
    return found is not None


def count_sessions(connection: sqlite3.Connection) -> int:
    """How many are open."""
    return connection.execute("SELECT count(*) FROM sessions").fetchone()[0]


def newest_use(connection: sqlite3.Connection) -> float:
    """When a session was used last; 0 where none is open."""
    return connection.execute("SELECT coalesce(max(touched_at), 0) FROM sessions").fetchone()[0]


def _utc(seconds: float) -> datetime:
    return datetime.fromtimestamp(seconds, timezone.utc)
