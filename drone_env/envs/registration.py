"""Every task under its Gymnasium id, such as `DroneDelivery-Easy-v1`."""

import gymnasium

from drone_env.core.tasks import PAST_TASKS, TASKS, TaskConfig
from drone_env.errors import InvalidValueError


def register_envs() -> None:
    """Register each task and version that is not registered yet."""
    for task in (*TASKS.values(), *PAST_TASKS):
        if task.gym_id not in gymnasium.registry:
            gymnasium.register(
                id=task.gym_id,
                entry_point="drone_env.envs.drone_delivery:DroneDeliveryEnv",
                vector_entry_point="drone_env.envs.vector:DroneDeliveryVectorEnv",
                kwargs={"task": task.id, "version": task.version, "gym_id": task.gym_id},
            )


def check_gym_id(gym_id: str | None, task: TaskConfig) -> None:
    """See that an environment made under a Gymnasium id flies the task of that id.

    Raises:
        InvalidValueError: if it is another task's.
    """
    if gym_id not in (None, task.gym_id):
        raise InvalidValueError(f"{gym_id} does not fly task {task.id!r}: make {task.gym_id}, or leave the task out")
