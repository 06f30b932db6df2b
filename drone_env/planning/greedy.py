"""The nearest-target rule: fly straight to the current target, which is the nearest parcel when it is chosen.

Where terrain costs or blocks, the nearest target is the one that is cheapest to reach. Nothing else is heeded: neither
what the battery still holds nor where it could be charged.
"""

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Action
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.planning.paths import towards


def greedy_action(task: TaskConfig, observation: Observation) -> Action:
    """The next action towards the nearest target; WAIT when nothing is left."""
    return Action(int(greedy_actions(task, observation["grid"][None], observation["telemetry"][None])[0]))


def greedy_actions(
    task: TaskConfig, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]
) -> npt.NDArray[np.int64]:
    """The same for N episodes: int64[N] from grids uint8[N, H, W] and telemetry float32[N, telemetry_size]."""
    drones, targets = positions(task, telemetry)
    if task.uniform:
        return towards(drones, targets)
    from drone_env.planning.cheapest_path import cheapest_actions  # compiles, which only these tasks are worth

    return cheapest_actions(task, grids, drones)


def positions(
    task: TaskConfig, telemetry: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """(x, y) of drones and of their current targets, int64[N, 2] each, from telemetry float32[N, telemetry_size]."""
    sides = np.array([task.width, task.height])
    drones, targets = (np.rint(telemetry[:, i : i + 2] * sides).astype(np.int64) for i in (0, 3))
    return drones, targets
