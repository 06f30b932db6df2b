"""Grade a state by the formula of `core.rules`, which all graders share."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from drone_env.core.rules import score_of
from drone_env.core.tables import interpreted
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError
from drone_env.models import DroneState

Grader = Callable[[DroneState | Mapping[str, Any]], float]


def make_grader(task_name: str) -> Grader:
    """Return the grader of a task: `grade` with its first argument bound."""
    return partial(grade, task_name)


def grade(task_name: str, state: DroneState | Mapping[str, Any]) -> float:
    """Return the score of a state, in [0.01, 0.99]; it is provisional before the end of the episode.

    The score is computed from the counts of the state; the field `score` is ignored.

    Args:
        task_name: The task of the grader.
        state: A `DroneState` or the same as a dictionary.

    Raises:
        pydantic.ValidationError: if the dictionary is not a `DroneState`.
        InvalidValueError: if the state belongs to another task.
    """
    if not isinstance(state, DroneState):
        state = DroneState.model_validate(state)
    task = get_task(task_name, state.task_version)
    if get_task(state.task_name, state.task_version) != task:
        raise InvalidValueError(f"the grader of {task.id!r} got a state of {state.task_name!r}")
    return score_of(interpreted(task), state.deliveries_done, state.battery_steps_remaining, state.step_count)
