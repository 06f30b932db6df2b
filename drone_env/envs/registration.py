"""Every task under its Gymnasium id, such as `DroneDelivery-Easy-v1`."""

import gymnasium

from drone_env.core.tasks import PAST_TASKS, TASKS


def register_envs() -> None:
    """Register each task and version that is not registered yet."""
    for task in (*TASKS.values(), *PAST_TASKS):
        if task.gym_id not in gymnasium.registry:
            gymnasium.register(
                id=task.gym_id,
                entry_point="drone_env.envs.drone_delivery:DroneDeliveryEnv",
                vector_entry_point="drone_env.envs.vector:DroneDeliveryVectorEnv",
                kwargs={"task": task.id, "version": task.version},
            )
