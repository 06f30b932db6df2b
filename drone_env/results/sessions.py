"""A session as it is kept: which map, which actions so far. Flying them again gives its episode.

The functions at the end read and write its row, inside a transaction that the store has begun.
"""

import re
import secrets
import sqlite3
import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields

from drone_env.core.actions import check_action
from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile
from drone_env.core.seeds import check_seed
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import EpisodeError, InvalidValueError, NoSessionError, SessionGoneError
from drone_env.results.finished import StoredEpisode, check_agent

FINISHED_SECONDS = 30.0
"""For so long a finished session keeps its place even where others have none: its owner still asks for the score."""
GONE_SECONDS = 7 * 24 * 3600.0
CHARACTERS = bytes.maketrans(bytes(range(10)), b"0123456789")
NUMBERS = bytes.maketrans(b"0123456789", bytes(range(10)))
"""Actions are kept as a text of digits; these turn bytes with their numbers into it, and back."""
EPISODE_ID = re.compile(r"[0-9a-f]{16}")
"""What the store names an episode."""


@dataclass
class SessionRow:
    """One session. Inside `Store.session` its methods note changes, which are kept together when the block ends.

    Attributes:
        id: Names the session; who knows it may fly it.
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
        finished: The episodes that `finish` noted.
    """

    id: str
    task: str
    task_version: int
    seed: int
    reward_profile: str
    agent: str
    actions: tuple[int, ...]
    episode_id: str | None
    opened_at: float
    touched_at: float
    address: str | None = None
    finished: list[StoredEpisode] = field(default_factory=list[StoredEpisode])

    @property
    def flight(self) -> tuple[str, int, int, str]:
        """What is flown: task, its version, seed, reward profile."""
        return self.task, self.task_version, self.seed, self.reward_profile

    def follows(self, episode: Episode) -> bool:
        """Whether this session flies the map of an episode, with the same actions as far as that has come."""
        flown = tuple(episode.actions)
        return flight_of(episode) == self.flight and self.actions[: len(flown)] == flown

    def step(self, episode: Episode, action: int) -> float:
        """Fly one action of the episode of this session and note it; after the end nothing changes. Its reward."""
        over = episode.ended
        reward = episode.step(action)
        if not over:
            self.append(action)
            if episode.ended:
                self.finish(episode)
        return reward

    def append(self, action: object) -> None:
        """Note one more action.

        Raises:
            EpisodeError: if the episode has been finished: reset first.
            InvalidValueError: if it is not an action.
        """
        if self.episode_id is not None:
            raise EpisodeError("the episode of this session has ended: reset to fly again")
        self.actions = (*self.actions, check_action(action))

    def undo(self) -> None:
        """Take the last action back.

        Raises:
            EpisodeError: if the episode has been finished, which is kept as it is, or nothing has been flown.
        """
        if self.episode_id is not None:
            raise EpisodeError("the episode of this session has ended: reset to fly again")
        if not self.actions:
            raise EpisodeError("nothing has been flown that could be taken back")
        self.actions = self.actions[:-1]

    def finish(self, episode: Episode, episode_id: str | None = None) -> str:
        """Note that the episode has ended, and return the id under which the store will know it.

        Args:
            episode: The episode of this session, flown to its end with the actions noted here.
            episode_id: That id, for one that may be stored already, which is then kept as it is; None for a new one.

        Raises:
            EpisodeError: if it has been finished already, or has not ended.
            InvalidValueError: if the episode is another one than this session's.
        """
        if self.episode_id is not None:
            raise EpisodeError("the episode of this session has been finished already")
        stored = StoredEpisode.of(episode_id or new_episode_id(), episode, self.agent)
        if flight_of(episode) != self.flight:
            raise InvalidValueError(f"the session flies {self.flight}, this is an episode of {flight_of(episode)}")
        if tuple(episode.actions) != self.actions:
            raise InvalidValueError(
                f"the session has noted {len(self.actions)} actions, which are not the {episode.steps} of this episode"
            )
        self.finished.append(stored)
        self.episode_id = stored.id
        return stored.id

    def reset(self, task: str, task_version: int, seed: int, reward_profile: str, agent: str | None = None) -> None:
        """Start a map in this session; an episode that has not ended is dropped.

        Args:
            task: Name of the task.
            task_version: Version of the task.
            seed: Number of the map.
            reward_profile: Id of the reward profile.
            agent: Who flies from now on; None for the present one.

        Raises:
            UnknownNameError: if there is no such task, version or profile.
            InvalidValueError: if the seed is not in [0, 2^53), or the agent's name is not one printable line.
        """
        task = known_task(task, task_version, seed, reward_profile).id
        if agent is not None:
            self.agent = check_agent(agent)
        self.task, self.task_version, self.seed, self.reward_profile = task, task_version, int(seed), reward_profile
        self.actions = ()
        self.episode_id = None

    def begin(self) -> Episode:
        """The episode of this session at its reset.

        Raises:
            UnknownNameError: if there is no such task or profile any more.
        """
        return Episode(get_task(self.task, self.task_version), self.reward_profile, self.seed)

    def fly(self) -> Episode:
        """The episode of this session, flown again from its reset: some microseconds per action. Raises as `begin`."""
        return self.begin().fly(self.actions)


COLUMNS = [column.name for column in fields(SessionRow) if column.name != "finished"]
ACTIONS = COLUMNS.index("actions")
SELECT = f"SELECT {', '.join(COLUMNS)} FROM sessions WHERE id = ?"


def flight_of(episode: Episode) -> tuple[str, int, int, str]:
    """The same of an episode as `SessionRow.flight`."""
    return episode.task.id, episode.task.version, episode.seed, episode.reward_profile.id


def known_task(task: str, task_version: int, seed: int, reward_profile: str) -> TaskConfig:
    """The task, if this flight can be flown.

    Raises:
        UnknownNameError: if there is no such task, version or profile.
        InvalidValueError: if the seed is not in [0, 2^53).
    """
    get_reward_profile(reward_profile)
    check_seed(seed)
    return get_task(task, task_version)


def new_episode_id() -> str:
    """A name for a finished episode."""
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


def session_row(connection: sqlite3.Connection, session_id: str) -> SessionRow:
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
    row = SessionRow(*found)
    row.actions = tuple(found[ACTIONS].encode().translate(NUMBERS))
    return row


def update_session(connection: sqlite3.Connection, row: SessionRow, now: float) -> None:
    """Write a session as it stands, used just now."""
    connection.execute(
        "UPDATE sessions SET task = :task, task_version = :task_version, seed = :seed, agent = :agent, "
        "reward_profile = :reward_profile, actions = :actions, episode_id = :episode_id, touched_at = :now, "
        "address = :address WHERE id = :id",
        {**vars(row), "actions": bytes(row.actions).translate(CHARACTERS).decode(), "now": now},
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
