"""A session as it is kept: which map, which actions so far. Flying them again gives its episode."""

import re
import secrets
from dataclasses import dataclass, field
from datetime import datetime

from drone_env.core.actions import check_action
from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile
from drone_env.core.seeds import check_seed
from drone_env.core.tasks import get_task
from drone_env.episodes.finished import StoredEpisode, check_agent
from drone_env.errors import EpisodeError, InvalidValueError, SessionGoneError, WithdrawnError

EPISODE_ID = re.compile(r"[0-9a-f]{16}")
"""What the store names an episode."""


@dataclass
class SessionRow:
    """One session. Inside `Store.session` its methods note changes, which are kept together when the block ends.

    Attributes:
        id: Names the session; whoever knows it may fly it.
        task: Id of the task.
        task_version: Version of the task.
        seed: Number of the map.
        reward_profile: Id of the reward profile.
        agent: Who flies.
        actions: The actions flown on this map, as numbers, in order.
        episode_id: The finished episode of this map in the store, None while it has not ended.
        opened_at: When the session was opened, UTC.
        touched_at: When it was last used, UTC, before this use.
        finished: The episodes that `finish` noted.
        address: Where those are who fly it without naming it; None for a session that has been named.
    """

    id: str
    task: str
    task_version: int
    seed: int
    reward_profile: str
    agent: str
    actions: tuple[int, ...]
    episode_id: str | None
    opened_at: datetime
    touched_at: datetime
    finished: list[StoredEpisode] = field(default_factory=list[StoredEpisode])
    address: str | None = None

    def append(self, action: object) -> None:
        """Note one more action.

        Raises:
            EpisodeError: if the episode has been finished: reset first.
            InvalidValueError: if it is not an action.
        """
        if self.episode_id is not None:
            raise EpisodeError("the episode of this session has ended: reset to fly again")
        self.actions = (*self.actions, check_action(action))

    def finish(self, episode: Episode) -> str:
        """Note that the episode has ended, and return the id under which the store will know it.

        Args:
            episode: The episode of this session, flown to its end with the actions noted here.

        Raises:
            EpisodeError: if it has been finished already, or has not ended.
            InvalidValueError: if the episode is another one than this session's.
        """
        if self.episode_id is not None:
            raise EpisodeError("the episode of this session has been finished already")
        stored = StoredEpisode.of(new_episode_id(), episode, self.agent)
        flown = (episode.task.id, episode.task.version, episode.seed, episode.reward_profile.id)
        noted = (self.task, self.task_version, self.seed, self.reward_profile)
        if flown != noted:
            raise InvalidValueError(f"the session flies {noted}, this is an episode of {flown}")
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
        task = known_task(task, task_version, seed, reward_profile)
        if agent is not None:
            self.agent = check_agent(agent)
        self.task, self.task_version, self.seed, self.reward_profile = task, task_version, int(seed), reward_profile
        self.actions = ()
        self.episode_id = None

    def begin(self) -> Episode:
        """The episode of this session at its reset.

        Raises:
            SessionGoneError: if this version of its task is withdrawn, so that nobody can fly it.
            UnknownNameError: if there is no such task or profile any more.
        """
        try:
            task = get_task(self.task, self.task_version)
        except WithdrawnError as error:
            raise SessionGoneError(str(error)) from None
        return Episode(task, self.reward_profile, self.seed)

    def fly(self) -> Episode:
        """The episode of this session, flown anew from its reset: some microseconds per action. Raises as `begin`."""
        return self.begin().fly(self.actions)


def known_task(task: str, task_version: int, seed: int, reward_profile: str) -> str:
    """The id of a task, if this flight can be flown.

    Raises:
        UnknownNameError: if there is no such task, version or profile.
        InvalidValueError: if the seed is not in [0, 2^53).
    """
    get_reward_profile(reward_profile)
    check_seed(seed)
    return get_task(task, task_version).id


def new_episode_id() -> str:
    """A name for a finished episode."""
    return secrets.token_hex(8)
