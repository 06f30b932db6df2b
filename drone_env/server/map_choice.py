"""Which map a reset chooses, and what its steps pay; splits are named `task/split`."""

import secrets

from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE, get_reward_profile
from drone_env.core.seeds import SPLITS, next_seed
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.server.schemas import ResetOptions

DEFAULT_TASK = "easy_delivery"


def start_episode(options: ResetOptions, last_seed: int | None, task: str = DEFAULT_TASK) -> Episode:
    """The episode that a reset asks for, at its start.

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
            known, seed = find_map(options.split, options.index)
        except IndexError as error:
            raise InvalidValueError(str(error)) from None
        return Episode(known, profile, seed)
    seed = options.seed
    if seed is None:
        seed = secrets.randbelow(SPLITS["train"].stop) if last_seed is None else next_seed(last_seed)
    return Episode(options.task_name or task, profile, seed)


def is_registered(task: str) -> bool:
    """Whether a name is that of one of the server's own tasks, not of a map that a visitor drew."""
    return any(task in (known.id, known.short_name, known.grader) for known in TASKS.values())


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
