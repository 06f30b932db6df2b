"""Sessions: a map and the actions flown so far, from which the episode is flown again."""

import re
import secrets
from dataclasses import dataclass, field

from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.results.finished import StoredEpisode, check_agent

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
        owner: The address that opened it; empty if it is unknown.
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
    owner: str = ""
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
        """Copy the episode in memory of an earlier state of this session, and fly the actions since."""
        if other is not None and other.episode is not None and self.follows(other):
            self.episode = other.episode.copy().fly(self.actions[len(other.actions) :])

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
        UnknownNameError: as `Session.fly`.
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


def in_share(own: int, taken: int, capacity: int) -> bool:
    """Return whether an address may take one more of `capacity` places: it holds fewer than are free.

    One address thus takes at most half of the places, two take a third each, and a newcomer finds one free.

    Args:
        own: The places that the address holds.
        taken: The places that all addresses hold.
        capacity: The number of places.
    """
    return own < capacity - taken


def flight_of(episode: Episode) -> Flight:
    """Return `Session.flight` of an episode."""
    return episode.task.id, episode.task.version, episode.seed, episode.reward_profile.id


def new_episode_id() -> str:
    """Return a new id for a finished episode."""
    return secrets.token_hex(8)
