"""Sessions: a map and the actions flown so far, from which the episode is flown again.

The functions at the end read and write the row of a session, inside a transaction of the store.
"""

import re
import secrets
import sqlite3
from dataclasses import dataclass, field
from typing import Any

from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import NoSessionError, SessionGoneError
from drone_env.results.finished import StoredEpisode, check_agent

FINISHED_SECONDS = 30.0
"""A finished session is not evicted for this long: its owner still needs the score."""
GONE_SECONDS = 7 * 24 * 3600.0
TO_DIGITS = bytes.maketrans(bytes(range(10)), b"0123456789")
TO_NUMBERS = bytes.maketrans(b"0123456789", bytes(range(10)))
"""The store writes actions as digits; these tables translate bytes of numbers to digits and back."""
EPISODE_ID = re.compile(r"[0-9a-f]{16}")
"""Form of the id of a stored episode."""
Flight = tuple[str, int, int, str]
"""Task, its version, seed, reward profile."""


@dataclass
class Session:
    """A caller's place on the server. `Store.session` writes all its changes in one transaction.

    Attributes:
        id: The secret id. Empty for the session of a connection, which has no row.
        task: Id of the task.
        task_version: Version of the task.
        seed: Number of the map.
        reward_profile: Id of the reward profile.
        agent: Name of the pilot.
        actions: The actions flown on this map, in order.
        episode_id: Id of the finished episode in the store; None before the end.
        opened_at: When the session was opened, in seconds since 1970.
        touched_at: When it was last used.
        address: The address whose callers share it without naming it; None after somebody has named it.
        episode: The episode in memory after all actions; None if it is not in memory.
        finished: Episodes that have ended and are not stored yet.
    """

    id: str
    task: str
    task_version: int
    seed: int
    reward_profile: str
    agent: str
    actions: tuple[int, ...] = ()
    episode_id: str | None = None
    opened_at: float = 0.0
    touched_at: float = 0.0
    address: str | None = None
    episode: Episode | None = field(default=None, compare=False)
    finished: list[StoredEpisode] = field(default_factory=list[StoredEpisode])

    @property
    def flight(self) -> Flight:
        """Task, its version, seed, reward profile."""
        return self.task, self.task_version, self.seed, self.reward_profile

    def follows(self, other: "Session") -> bool:
        """Whether this session flies the map of another and begins with its actions."""
        return self.flight == other.flight and self.actions[: len(other.actions)] == other.actions

    def go_on_from(self, other: "Session | None") -> None:
        """Reuse the episode in memory of an earlier state of this session, and fly the actions since."""
        if other is not None and other.episode is not None and self.follows(other):
            self.episode = other.episode.fly(self.actions[len(other.actions) :])

    def begin(self, episode: Episode, agent: str | None = None) -> None:
        """Start an episode in this session. An unfinished one is dropped.

        Args:
            episode: The episode, at its start.
            agent: Name of the new pilot; None for the present one.

        Raises:
            InvalidValueError: if the agent's name is not one printable line.
        """
        if agent is not None:
            self.agent = check_agent(agent)
        self.task, self.task_version, self.seed, self.reward_profile = flight_of(episode)
        self.actions, self.episode_id, self.episode = (), None, episode

    def fly(self) -> Episode:
        """Return the episode after all actions.

        Raises:
            UnknownNameError: if its task or profile is no longer registered.
        """
        if self.episode is None:
            task = get_task(self.task, self.task_version)
            self.episode = Episode(task, self.reward_profile, self.seed).fly(self.actions)
        return self.episode


def advance(session: Session, action: int) -> float:
    """Fly one action in a session: the one step of HTTP, OpenEnv and the live page.

    After the end of the episode nothing changes.

    Returns:
        The reward.

    Raises:
        InvalidValueError: if it is not an action.
        SessionGoneError, UnknownNameError: as `Session.fly`.
    """
    episode = session.fly()
    over = episode.ended
    reward = episode.step(action)
    if not over:
        session.actions = (*session.actions, int(action))
        if episode.ended:
            stored = StoredEpisode.of(new_episode_id(), episode, session.agent)
            session.finished.append(stored)
            session.episode_id = stored.id
    return reward


def flight_of(episode: Episode) -> Flight:
    """Return `Session.flight` of an episode."""
    return episode.task.id, episode.task.version, episode.seed, episode.reward_profile.id


def new_episode_id() -> str:
    """Return a new id for a finished episode."""
    return secrets.token_hex(8)


def session_row(connection: sqlite3.Connection, session_id: str) -> Session:
    """Read a session.

    Raises:
        NoSessionError: if there never was such a session.
        SessionGoneError: if it has ended or expired.
    """
    # Ids are ASCII, and SQLite rejects lone surrogates.
    known = session_id if session_id.isascii() else ""
    row = connection.execute("SELECT * FROM sessions WHERE id = ?", (known,)).fetchone()
    if row is None:
        if connection.execute("SELECT 1 FROM gone_sessions WHERE id = ?", (known,)).fetchone():
            raise SessionGoneError("this session has ended or was idle for too long: open a new one")
        raise NoSessionError("there is no such session: open one first")
    columns: dict[str, Any] = {**row}
    columns["actions"] = tuple(row["actions"].encode().translate(TO_NUMBERS))
    return Session(**columns)


def update_session(connection: sqlite3.Connection, session: Session, now: float) -> None:
    """Write a session and count it as used now."""
    connection.execute(
        "UPDATE sessions SET task = :task, task_version = :task_version, seed = :seed, agent = :agent, "
        "reward_profile = :reward_profile, actions = :actions, episode_id = :episode_id, touched_at = :now, "
        "address = :address WHERE id = :id",
        {**vars(session), "actions": bytes(session.actions).translate(TO_DIGITS).decode(), "now": now},
    )


def end_session(connection: sqlite3.Connection, session_id: str, now: float) -> None:
    """Delete a session and remember that it is gone."""
    connection.execute("DELETE FROM sessions WHERE id = ?", (session_id,))
    connection.execute("INSERT OR REPLACE INTO gone_sessions VALUES (?, ?)", (session_id, now))


def end_finished(connection: sqlite3.Connection, now: float) -> bool:
    """End the finished session that was idle longest, if it may be evicted. Return whether there was one."""
    row = connection.execute(
        "SELECT id FROM sessions WHERE episode_id IS NOT NULL AND touched_at <= ? ORDER BY touched_at LIMIT 1",
        (now - FINISHED_SECONDS,),
    ).fetchone()
    if row is not None:
        end_session(connection, row["id"], now)
    return row is not None


def end_idle(connection: sqlite3.Connection, now: float, idle_seconds: float) -> list[str]:
    """End the sessions that are idle for this long and return their ids. Forget those that are gone for a week."""
    idle = connection.execute("SELECT id FROM sessions WHERE touched_at <= ?", (now - idle_seconds,)).fetchall()
    for (session_id,) in idle:
        end_session(connection, session_id, now)
    connection.execute("DELETE FROM gone_sessions WHERE gone_at < ?", (now - GONE_SECONDS,))
    return [session_id for (session_id,) in idle]
