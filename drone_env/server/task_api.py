"""The map of a reset, and OpenEnv's task API: each task has three splits, and map i of a split is its i-th seed."""

import secrets

import numpy as np
from typing_extensions import NotRequired, TypedDict

from drone_env.agents.base import rollout_batch
from drone_env.agents.simple import GreedyAgent
from drone_env.core.episode import Episode
from drone_env.core.rewards import get_reward_profile
from drone_env.core.seeds import SPLITS, next_seed
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.server.schemas import ResetOptions

DEFAULT_TASK = "easy_delivery"
PREVIEW = 1000
"""Maximum number of maps in a list; `the 1,000 test maps` are the first of the test split."""
MOST_CELLS = 400
"""Of a map with a difficulty: greedy flies 1,000 such maps in a second of CPU, and 64 x 64 cells in 80 seconds."""


def start_episode(options: ResetOptions, last_seed: int | None, task: str = DEFAULT_TASK) -> Episode:
    """The episode of a reset, at its start.

    Args:
        options: The reset.
        last_seed: The last map of the session; a reset without a seed flies the next one on the walk. None for a new
            session, whose first map is random within the train split.
        task: The task of a reset that names none.

    Raises:
        UnknownNameError: if the task, profile or split does not exist.
        InvalidValueError: if the split has no such map.
    """
    profile = get_reward_profile(options.reward_profile or options.default_profile)
    if options.split is not None and options.index is not None:
        try:
            chosen, number = TaskApi().map_of(options.split, options.index)
        except IndexError as error:
            raise InvalidValueError(str(error)) from None
        return Episode(chosen, profile, number)
    seed = options.seed
    if seed is None:
        seed = secrets.randbelow(SPLITS["train"].stop) if last_seed is None else next_seed(last_seed)
    return Episode(options.task_name or task, profile, seed)


def is_registered(task: str) -> bool:
    """Whether a name belongs to a registered task, not to a drawn map."""
    return any(task in (known.id, known.short_name, known.grader) for known in TASKS.values())


def task_in(split: str) -> str:
    """The task of a split, `task/split`."""
    return split.rpartition("/")[0]


class SplitInfo(TypedDict):
    """A split."""

    name: str
    type: str


class TaskSpec(TypedDict):
    """One map of a split, by the keys that OpenEnv's samplers read."""

    id: str
    index: int
    split: str
    group: str
    """The task, as `task_name`."""
    difficulty: NotRequired[float]
    """The part of the score that `greedy` misses, in tenths; not for maps of more than `MOST_CELLS` cells."""
    task_name: str
    seed: int


class TaskApi:
    """OpenEnv's task API. The names of splits are `task/split`."""

    def list_splits(self) -> list[SplitInfo]:
        """All splits; `reset(split=..., index=...)` flies one of their maps."""
        return [{"name": f"{task}/{split}", "type": split} for task in TASKS for split in SPLITS]

    def num_tasks(self, split: str) -> int:
        """The number of maps of a split."""
        return len(self._find(split)[1])

    def list_tasks(self, split: str) -> list[TaskSpec]:
        """The first 1,000 maps of a split."""
        return self.get_task_range(split, 0, PREVIEW)

    def get_task_range(self, split: str, start: int | None = None, stop: int | None = None) -> list[TaskSpec]:
        """Maps start to stop (exclusive) of a split, at most 1,000 of them.

        Raises:
            UnknownNameError: if there is no such split.
            InvalidValueError: if the range is outside the split or too long.
        """
        size = self.num_tasks(split)
        first = 0 if start is None else start
        last = min(first + PREVIEW, size) if stop is None else stop
        if not (0 <= first <= last <= size and last - first <= PREVIEW):
            message = f"{split!r} has {size} maps and lists {PREVIEW} at a time; got {first} to {last}"
            raise InvalidValueError(message)
        return self._specs(split, range(first, last))

    def get_task(self, split: str, index: int) -> TaskSpec:
        """One map of a split.

        Raises:
            UnknownNameError: if there is no such split.
            IndexError: if it has no such map.
        """
        self.map_of(split, index)
        return self._specs(split, range(index, index + 1))[0]

    def map_of(self, split: str, index: int) -> tuple[TaskConfig, int]:
        """The task and the seed of one map of a split; raises as `get_task`."""
        task, seeds = self._find(split)
        if not 0 <= index < len(seeds):
            raise IndexError(f"split {split!r} has {len(seeds)} maps; there is no number {index}")
        return task, seeds[index]

    def _specs(self, split: str, indices: range) -> list[TaskSpec]:
        task, seeds = self._find(split)
        specs = [
            TaskSpec(id=f"{split}/{i}", index=i, split=split, group=task.id, task_name=task.id, seed=seeds[i])
            for i in indices
        ]
        if specs and task.width * task.height <= MOST_CELLS:
            maps = np.array([spec["seed"] for spec in specs])
            scores = rollout_batch(task, maps, GreedyAgent(task).act_batch, stateless=True).scores
            for spec, score in zip(specs, scores.tolist(), strict=True):
                spec["difficulty"] = round(1 - score, 1)
        return specs

    def _find(self, split: str) -> tuple[TaskConfig, range]:
        task, _, name = split.rpartition("/")
        try:
            return get_task(task), range(*SPLITS[name])
        except (UnknownNameError, KeyError):
            raise UnknownNameError("split", split, [one["name"] for one in self.list_splits()]) from None
