"""The nearest-target rule: fly straight to the current target, which is the nearest parcel when it is chosen."""

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Action
from drone_env.core.state_manager import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.planning.paths import Position, towards


def drone_position(task: TaskConfig, observation: Observation) -> Position:
    """(x, y) of the drone, from the telemetry."""
    return _position(task, observation, 0)


def target_position(task: TaskConfig, observation: Observation) -> Position:
    """(x, y) of the current target, from the telemetry; the drone's own when nothing is left."""
    return _position(task, observation, 3)


def greedy_action(task: TaskConfig, observation: Observation) -> Action:
    """The next action towards the current target; WAIT when nothing is left."""
    return towards(drone_position(task, observation), target_position(task, observation))


def positions(
    task: TaskConfig, telemetry: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """(x, y) of the drones and of their current targets, int64[N, 2] each, from telemetry float32[N, 5 or 6]."""
    sides = np.array([task.width, task.height])
    drones, targets = (np.rint(telemetry[:, i : i + 2] * sides).astype(np.int64) for i in (0, 3))
    return drones, targets


def _position(task: TaskConfig, observation: Observation, index: int) -> Position:
    x, y = observation["telemetry"][index : index + 2].tolist()
    return round(x * task.width), round(y * task.height)
