"""OpenEnv's task API: every task has our three seed splits, and map i of a split is its i-th seed."""

from typing import Any

from drone_env.core.seeds import SPLITS
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.errors import InvalidValueError, UnknownNameError

PREVIEW = 1000
"""How many maps a list shows; `the 1,000 test maps` are these of the test split."""


def list_splits() -> list[dict[str, str]]:
    """All splits, named `task/split`."""
    return [{"name": name, "type": name.partition("/")[2]} for name in _names()]


def num_tasks(split: str) -> int:
    """How many maps a split has.

    Raises:
        UnknownNameError: if there is no such split.
    """
    _, (start, stop) = _find(split)
    return stop - start


def list_tasks(split: str) -> list[dict[str, Any]]:
    """The first 1,000 maps of a split.

    Raises:
        UnknownNameError: if there is no such split.
    """
    return get_task_range(split, 0, PREVIEW)


def get_task_range(split: str, start: int | None = None, stop: int | None = None) -> list[dict[str, Any]]:
    """Maps start to stop (exclusive) of a split, at most 1,000 of them.

    Raises:
        UnknownNameError: if there is no such split.
        InvalidValueError: if the range is not within the split, or too long.
    """
    size = num_tasks(split)
    first = 0 if start is None else start
    last = min(first + PREVIEW, size) if stop is None else stop
    if not (0 <= first <= last <= size and last - first <= PREVIEW):
        raise InvalidValueError(f"{split!r} has {size} maps, {PREVIEW} of them at a time; asked for {first} to {last}")
    return [describe(split, index) for index in range(first, last)]


def describe(split: str, index: int) -> dict[str, Any]:
    """One map of a split, as a task of OpenEnv.

    Raises:
        UnknownNameError: if there is no such split.
        IndexError: if it has no such map.
    """
    task, seed = find_map(split, index)
    return {"id": f"{split}/{index}", "index": index, "split": split, "task_name": task.id, "seed": seed}


def find_map(split: str, index: int) -> tuple[TaskConfig, int]:
    """Task and seed of a map.

    Raises:
        UnknownNameError: if there is no such split.
        IndexError: if it has no such map.
    """
    task, (start, stop) = _find(split)
    if not 0 <= index < stop - start:
        raise IndexError(f"split {split!r} has {stop - start} maps; there is no number {index}")
    return task, start + index


def _find(split: str) -> tuple[TaskConfig, tuple[int, int]]:
    task, _, name = split.rpartition("/")
    try:
        return get_task(task), SPLITS[name]
    except (UnknownNameError, KeyError):
        raise UnknownNameError("split", split, _names()) from None


def _names() -> list[str]:
    return [f"{task}/{split}" for task in TASKS for split in SPLITS]
