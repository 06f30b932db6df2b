"""Which map a reset chooses, and what its steps pay; splits are named `task/split`."""

import secrets
from typing import NamedTuple

from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE, RewardProfile, get_reward_profile
from drone_env.core.seeds import SPLITS, next_seed
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.server.schemas import ResetOptions

DEFAULT_TASK = "easy_delivery"


class MapChoice(NamedTuple):
    """Which map to fly, and what steps pay."""

    task: TaskConfig
    seed: int
    reward_profile: RewardProfile

    @property
    def names(self) -> tuple[str, int, int, str]:
        """Task, its version, seed and reward profile, as a session's row names them."""
        return self.task.id, self.task.version, self.seed, self.reward_profile.id

    def episode(self) -> Episode:
        """An episode on the map, reset."""
        return Episode(self.task, self.reward_profile, self.seed)


def choose_map(options: ResetOptions, last_seed: int | None, task: str = DEFAULT_TASK) -> MapChoice:
    """What a reset asks for.

    Args:
        options: The reset.
        last_seed: The map that the session flew last: without a seed, the next on the walk follows. None for a new
            session, whose first map is drawn at random from the train split.
        task: The task where the reset names none.

    Raises:
        UnknownNameError: if there is no such task, profile or split.
        InvalidValueError: if the split has no such map.
    """
    profile = get_reward_profile(options.reward_profile or ORIGINAL_PROFILE)
    if options.split is not None and options.index is not None:
        try:
            return MapChoice(*find_map(options.split, options.index), profile)
        except IndexError as error:
            raise InvalidValueError(str(error)) from None
    seed = options.seed
    if seed is None:
        seed = secrets.randbelow(SPLITS["train"].stop) if last_seed is None else next_seed(last_seed)
    return MapChoice(get_task(options.task_name or task), seed, profile)


def split_names() -> list[str]:
    """The names of all splits."""
    return [f"{task}/{split}" for task in TASKS for split in SPLITS]


def find_split(split: str) -> tuple[TaskConfig, range]:
    """Task and seeds of a split.

    Raises:
        UnknownNameError: if there is no such split.
    """
    task, _, name = split.rpartition("/")
    try:
        return get_task(task), range(*SPLITS[name])
    except (UnknownNameError, KeyError):
        raise UnknownNameError("split", split, split_names()) from None


def find_map(split: str, index: int) -> tuple[TaskConfig, int]:
    """Task and seed of a map.

    Raises:
        UnknownNameError: if there is no such split.
        IndexError: if it has no such map.
    """
    task, seeds = find_split(split)
    if not 0 <= index < len(seeds):
        raise IndexError(f"split {split!r} has {len(seeds)} maps; there is no number {index}")
    return task, seeds[index]
