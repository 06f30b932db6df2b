"""Agents that plan an order of stops once, and then follow it."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import StatelessAgent
from drone_env.core.actions import Action
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL
from drone_env.core.tasks import TaskConfig
from drone_env.planning.from_observation import read_observations


class NearestAgent(StatelessAgent):
    """Flies to the nearest parcel from which a pad is in range; else fills up at a pad that leads on to one.

    It plans a whole flight by this rule, nearest neighbour with recharging, and again in a state that it did not plan.

    Args:
        task: The task.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.config: Mapping[str, object] = {"agent": "nearest", "version": 1}
        self._task = task
        self._planned: dict[int, int] = {}

    def reset(self, seed: int) -> None:
        """Forget all plans."""
        self._planned.clear()

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Forget all plans."""
        self._planned.clear()

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N]; WAIT if no stop is within reach."""
        grounds, drones = read_observations(self._task, grids, telemetry)
        actions = np.zeros(len(grids), np.int64)
        for i, (ground, drone) in enumerate(zip(grounds, drones, strict=True)):
            state = hash(ground.tobytes() + drone.tobytes())
            if state not in self._planned:
                self._plan(ground, drone)
            actions[i] = self._planned.setdefault(state, int(Action.WAIT))
        return actions

    def _plan(self, ground: npt.NDArray[np.uint8], drone: npt.NDArray[np.int64]) -> None:
        """Plan the actions of a flight from this state on."""
        from drone_env.planning.stops import measure_stops, rule_kernel, trace_kernel  # compiles

        cell, units, left = drone.tolist()
        stops = measure_stops(self._task, ground, cell)
        order, flown = np.zeros(2 * left + 2, np.int64), np.zeros((left, 4), np.int64)
        n = rule_kernel(stops, units, left, order)
        steps = trace_kernel(stops, order[:n], units, left, flown)
        for state, action in zip(flown[:steps, :3], flown[:steps, 3].tolist(), strict=True):
            if ground[state[0]] == DELIVERY_CELL:
                ground[state[0]] = DELIVERED_CELL
            self._planned[hash(ground.tobytes() + state.tobytes())] = action
