"""From a state to its score: the one formula of `core.rules`, behind every grader."""

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
    """The grader of a task: `grade` with the task filled in."""
    return partial(grade, task_name)


def grade(task_name: str, state: DroneState | Mapping[str, Any]) -> float:
    """The score of a state, in [0.01, 0.99]; provisional while the episode is in flight.

    Computed from the state's counts; its own `score` is not believed.

    Args:
        task_name: The task that the grader is for.
        state: A `DroneState` or the same as a dictionary.

    Raises:
        pydantic.ValidationError: if the dictionary is not a `DroneState`.
        InvalidValueError: if the state is of another task, or its counts are not those of the task.
    """
    if not isinstance(state, DroneState):
        state = DroneState.model_validate(state)
    task = get_task(task_name, state.task_version)
    if get_task(state.task_name, state.task_version) != task:
        raise InvalidValueError(f"the grader of {task.id!r} was given a state of {state.task_name!r}")
    counts = (state.deliveries_total, state.battery_capacity, state.max_steps)
    expected = (task.deliveries, task.battery_capacity, task.max_steps)
    if counts != expected:
        raise InvalidValueError(
            f"{task.id!r} has (deliveries_total, battery_capacity, max_steps) = {expected}; the state says {counts}"
        )
    return score_of(interpreted(task), state.deliveries_done, state.battery_steps_remaining, state.step_count)
