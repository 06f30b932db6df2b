"""The nearest-target rule: fly straight to the current target.

If terrain has costs or is impassable, the target is the parcel that is cheapest to reach. The rule ignores the battery
and never charges.
"""

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Action
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.planning.from_observation import drone_positions

UP, LEFT, WAIT = int(Action.UP), int(Action.LEFT), int(Action.WAIT)
"""DOWN is UP + 1, RIGHT is LEFT + 1."""


def greedy_action(task: TaskConfig, observation: Observation) -> Action:
    """The next action towards the nearest target; WAIT if nothing is left."""
    return Action(int(greedy_actions(task, observation["grid"][None], observation["telemetry"][None])[0]))


def greedy_actions(
    task: TaskConfig, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]
) -> npt.NDArray[np.int64]:
    """`greedy_action` for N episodes: int64[N] from grids uint8[N, H, W] and telemetry float32[N, telemetry_size]."""
    if task.uniform:  # along the row to the target, then along the column
        x, y, _, to_x, to_y, *_ = telemetry.T
        down_or_wait = np.where(y == to_y, WAIT, UP + (to_y > y))
        return np.where(x == to_x, down_or_wait, LEFT + (to_x > x))
    from drone_env.planning.paths import cheapest_actions  # Imported lazily: compiling takes seconds.

    return cheapest_actions(task, grids, drone_positions(task, grids, telemetry))
