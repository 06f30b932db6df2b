"""Agents without a plan: random actions, and greedy flight to the nearest parcel, whatever the battery."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import StatelessAgent
from drone_env.core.actions import N_ACTIONS, WAIT, Action
from drone_env.core.cells import DELIVERY_CELL
from drone_env.core.episode import Observation
from drone_env.core.seeds import map_key, next_key, task_key, uniform_below
from drone_env.core.tasks import TaskConfig
from drone_env.planning.from_observation import drone_positions

KEY = task_key("agent/random", 1)
UP, LEFT = int(Action.UP), int(Action.LEFT)
"""DOWN is UP + 1, RIGHT is LEFT + 1."""


class RandomAgent:
    """Uniformly random actions; equal seeds give equal actions."""

    stochastic = True

    def __init__(self, task: TaskConfig) -> None:
        self.config: Mapping[str, object] = {"agent": "random", "version": 1}
        self._key: Any = 0

    def reset(self, seed: int) -> None:
        """Start the sequence of actions of this seed."""
        self._key = map_key(KEY, seed)

    def act(self, observation: Observation) -> int:
        """The next action of the sequence."""
        self._key = next_key(self._key)
        return uniform_below(self._key, N_ACTIONS)

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Start the sequences of these seeds, int64[N]."""
        as_integers: Any = seeds  # arrays of 64-bit integers wrap like compiled integers
        self._key = map_key(KEY, as_integers)

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions of the sequences, int64[N]."""
        self._key = next_key(self._key)
        actions: Any = uniform_below(self._key, N_ACTIONS)
        return actions


class GreedyAgent(StatelessAgent):
    """Flies straight to the current target. If terrain costs or blocks, the target is the cheapest parcel to reach.

    It ignores the battery and never charges.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.config: Mapping[str, object] = {"agent": "greedy", "version": 1}
        self._task = task

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N]; WAIT if nothing is left."""
        if self._task.uniform:  # along the row to the target, then along the column
            x, y, _, to_x, to_y, *_ = telemetry.T
            down_or_wait = np.where(y == to_y, WAIT, UP + (to_y > y))
            return np.where(x == to_x, down_or_wait, LEFT + (to_x > x))
        from drone_env.planning.paths import NO_PATH, cheapest_paths  # Imported lazily: compiling takes seconds.

        x, y = drone_positions(self._task, grids, telemetry).T
        cells = grids.reshape(len(grids), -1)
        costs, first = cheapest_paths(self._task, cells, y * self._task.width + x)
        costs[cells != DELIVERY_CELL] = NO_PATH
        cheapest = np.arange(len(grids)), costs.argmin(axis=1)  # of equal ones the first in reading order
        return np.where(costs[cheapest] < NO_PATH, first[cheapest], WAIT)
