"""Sessions: which map, which actions so far. Flying them again gives the episode.

The functions at the end read and write the row of a session, inside a transaction of the store.
"""

import re
import secrets
import sqlite3
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields

from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import NoSessionError, SessionGoneError
from drone_env.results.finished import StoredEpisode, check_agent

FINISHED_SECONDS = 30.0
"""For so long a finished session keeps its place even where others have none: its owner still asks for the score."""
GONE_SECONDS = 7 * 24 * 3600.0
CHARACTERS = bytes.maketrans(bytes(range(10)), b"0123456789")
NUMBERS = bytes.maketrans(b"0123456789", bytes(range(10)))
"""Actions are kept as a text of digits; these turn bytes with their numbers into it, and back."""
EPISODE_ID = re.compile(r"[0-9a-f]{16}")
"""Form of the id of a stored episode."""
Flight = tuple[str, int, int, str]
"""Task, its version, seed, reward profile."""


@dataclass
class Session:
    """A caller's place on the server. Inside `Store.session` its changes are kept together when the block ends.

    Attributes:
        id: Names the session; who knows it may fly it. Empty for the session of a connection, which has no row.
        task: Id of the task.
        task_version: Version of the task.
        seed: Number of the map.
        reward_profile: Id of the reward profile.
        agent: Who flies.
        actions: The actions flown on this map, as numbers, in order.
        episode_id: The finished episode of this map in the store, None while it has not ended.
        opened_at: When the session was opened, in seconds since 1970.
        touched_at: When it was last used, before this use.
        address: Where those are who fly it without naming it; None for a session that has been named.
        episode: The episode in memory, which has flown all actions; None if it is not in memory.
        finished: The episodes that have ended and are to be stored.
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
        """What is flown: task, its version, seed, reward profile."""
        return self.task, self.task_version, self.seed, self.reward_profile

    def follows(self, other: "Session") -> bool:
        """Whether this session flies the map of another, and begins with its actions."""
        return self.flight == other.flight and self.actions[: len(other.actions)] == other.actions

    def go_on_from(self, other: "Session | None") -> None:
        """Take over the episode in memory of this session as it was before, and fly what has been flown since."""
        if other is not None and other.episode is not None and self.follows(other):
            self.episode = other.episode.fly(self.actions[len(other.actions) :])

    def begin(self, episode: Episode, agent: str | None = None) -> None:
        """Start an episode in this session; one that has not ended is dropped.

        Args:
            episode: The episode, at its start.
            agent: Who flies from now on; None for the present one.

        Raises:
            InvalidValueError: if the agent's name is not one printable line.
        """
        if agent is not None:
            self.agent = check_agent(agent)
        self.task, self.task_version, self.seed, self.reward_profile = flight_of(episode)
        self.actions, self.episode_id, self.episode = (), None, episode

    def fly(self) -> Episode:
        """The episode with all actions flown.

        Raises:
            UnknownNameError: if there is no such task or profile any more.
        """
        if self.episode is None:
            task = get_task(self.task, self.task_version)
            self.episode = Episode(task, self.reward_profile, self.seed).fly(self.actions)
        return self.episode


COLUMNS = [column.name for column in fields(Session) if column.name not in ("episode", "finished")]
ACTIONS = COLUMNS.index("actions")
SELECT = f"SELECT {', '.join(COLUMNS)} FROM sessions WHERE id = ?"


def advance(session: Session, action: int) -> float:
    """Fly one action in a session and note it: the one step of HTTP, OpenEnv and the live page.

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
    """What an episode flies, as `Session.flight`."""
    return episode.task.id, episode.task.version, episode.seed, episode.reward_profile.id


def new_episode_id() -> str:
    """A new id for a finished episode."""
    return secrets.token_hex(8)


def steady_clock(
    wall: Callable[[], float] = time.time, steady: Callable[[], float] = time.monotonic
) -> Callable[[], float]:
    """The time by which sessions are idle: right when the clock is made, in seconds since 1970, then never set.

    Args:
        wall: The machine's time, which people and programs set.
        steady: Seconds since any start.
    """
    offset = wall() - steady()
    return lambda: steady() + offset


def session_row(connection: sqlite3.Connection, session_id: str) -> Session:
    """A session.

    Raises:
        NoSessionError: if there never was such a session.
        SessionGoneError: if it has ended or expired.
    """
    # What is not ASCII cannot be an id, and may be no text for SQLite either.
    known = session_id if session_id.isascii() else ""
    found = connection.execute(SELECT, (known,)).fetchone()
    if found is None:
        if connection.execute("SELECT 1 FROM gone_sessions WHERE id = ?", (known,)).fetchone():
            raise SessionGoneError("this session has ended or was idle for too long: open a new one")
        raise NoSessionError("there is no such session: open one first")
    session = Session(*found)
    session.actions = tuple(found[ACTIONS].encode().translate(NUMBERS))
    return session


def update_session(connection: sqlite3.Connection, session: Session, now: float) -> None:
    """Write a session as it stands, used just now."""
    connection.execute(
        "UPDATE sessions SET task = :task, task_version = :task_version, seed = :seed, agent = :agent, "
        "reward_profile = :reward_profile, actions = :actions, episode_id = :episode_id, touched_at = :now, "
        "address = :address WHERE id = :id",
        {**vars(session), "actions": bytes(session.actions).translate(CHARACTERS).decode(), "now": now},
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


def end_idle(connection: sqlite3.Connection, now: float, idle_seconds: float) -> list[str]:
    """End the sessions that were not used for so long, and return their ids; forget those that are gone for a week."""
    idle = connection.execute("SELECT id FROM sessions WHERE touched_at <= ?", (now - idle_seconds,)).fetchall()
    for (session_id,) in idle:
        end_session(connection, session_id, now)
    connection.execute("DELETE FROM gone_sessions WHERE gone_at < ?", (now - GONE_SECONDS,))
    return [session_id for (session_id,) in idle]
