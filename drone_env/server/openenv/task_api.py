"""OpenEnv's task API: every task has our three seed splits, and map i of a split is its i-th seed."""

from typing_extensions import TypedDict

from drone_env.errors import InvalidValueError
from drone_env.server.map_choice import find_map, find_split, split_names

PREVIEW = 1000
"""How many maps a list shows; `the 1,000 test maps` are these of the test split."""


class SplitInfo(TypedDict):
    """A split."""

    name: str
    type: str


class TaskSpec(TypedDict):
    """One map of a split."""

    id: str
    index: int
    split: str
    task_name: str
    seed: int


class TaskApi:
    """The task API, as OpenEnv's environments have it."""

    def list_splits(self) -> list[SplitInfo]:
        """All splits, named `task/split`; `reset(split=..., index=...)` flies one of their maps."""
        return [{"name": name, "type": name.partition("/")[2]} for name in split_names()]

    def num_tasks(self, split: str) -> int:
        """How many maps a split has."""
        return len(find_split(split)[1])

    def list_tasks(self, split: str) -> list[TaskSpec]:
        """The first 1,000 maps of a split."""
        return self.get_task_range(split, 0, PREVIEW)

    def get_task_range(self, split: str, start: int | None = None, stop: int | None = None) -> list[TaskSpec]:
        """Maps start to stop (exclusive) of a split, at most 1,000 of them.

        Raises:
            UnknownNameError: if there is no such split.
            InvalidValueError: if the range is not within the split, or too long.
        """
        size = self.num_tasks(split)
        first = 0 if start is None else start
        last = min(first + PREVIEW, size) if stop is None else stop
        if not (0 <= first <= last <= size and last - first <= PREVIEW):
            message = f"{split!r} has {size} maps, {PREVIEW} of them at a time; asked for {first} to {last}"
            raise InvalidValueError(message)
        return [self.get_task(split, index) for index in range(first, last)]

    def get_task(self, split: str, index: int) -> TaskSpec:
        """One map of a split.

        Raises:
            UnknownNameError: if there is no such split.
            IndexError: if it has no such map.
        """
        task, seed = find_map(split, index)
        return {"id": f"{split}/{index}", "index": index, "split": split, "task_name": task.id, "seed": seed}
