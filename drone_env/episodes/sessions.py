"""A session as it is kept: which map, which actions so far. Flying them again gives its episode."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime

from drone_env.core.actions import N_ACTIONS, Action
from drone_env.core.rewards import get_reward_profile
from drone_env.core.seeds import check_seed
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import get_task
from drone_env.episodes.record import EpisodeRecord, record_of
from drone_env.errors import EpisodeError, InvalidValueError


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

    def append(self, action: int) -> None:
        """Note one more action.

        Raises:
            EpisodeError: if the episode has been finished: reset first.
            InvalidValueError: if it is not an action.
        """
        raise NotImplementedError

    def finish(self, episode: Episode) -> str:
        """Note that the episode has ended, and return the id under which the store will know it.

        Args:
            episode: The episode of this session, flown to its end with the actions noted here.

        Raises:
            EpisodeError: if it has been finished already, or has not ended.
            InvalidValueError: if the episode is another one than this session's.
        """
        raise NotImplementedError

    def reset(
        self,
        task: str,
        task_version: int,
        seed: int,
        reward_profile: str,
        agent: str | None = None,
    ) -> None:
        """Start a map in this session; an episode that has not ended is dropped.

        Args:
            task: Id of the task.
            task_version: Version of the task.
            seed: Number of the map.
            reward_profile: Id of the reward profile.
            agent: Who flies from now on; None for the present one.

        Raises:
            UnknownNameError: if there is no such task, version or profile.
            InvalidValueError: if the seed is not in [0, 2^53), or the agent's name is not one printable line.
        """
        raise NotImplementedError

    def fly(self) -> Episode:
        """The episode of this session, flown anew from its reset; some microseconds per action."""
        raise NotImplementedError
