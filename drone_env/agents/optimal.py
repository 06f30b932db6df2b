"""The agent that flies the shortest tour, from nothing but what it observes."""

from collections.abc import Mapping

import numpy as np

from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.state_manager import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.planning.greedy import drone_position
from drone_env.planning.optimal import shortest_tour
from drone_env.planning.paths import Position, require_uniform, towards


class OptimalAgent:
    """Plans the shortest tour over the parcels that it sees and flies it; plans anew when the parcels differ.

    Raises:
        UnsupportedTaskError: if the task is not `uniform`.
    """

    def __init__(self, task: TaskConfig) -> None:
        require_uniform(task)
        self.config: Mapping[str, object] = {"agent": "optimal", "version": 1}
        self._task = task
        self._tour: list[Position] = []

    def reset(self, seed: int) -> None:
        """Forget the last tour."""
        self._tour = []

    def act(self, observation: Observation) -> int:
        """The next action of the tour; WAIT when no parcel is left within reach."""
        if not self._tour or observation["grid"][self._tour[0][::-1]] != Cell.DELIVERY:
            rows, columns = np.nonzero(observation["grid"] == Cell.DELIVERY)
            parcels = list(zip(columns.tolist(), rows.tolist(), strict=True))
            self._tour = shortest_tour(drone_position(self._task, observation), parcels, self._budget(observation))
        if not self._tour:
            return Action.WAIT
        return towards(drone_position(self._task, observation), self._tour[0])

    def _budget(self, observation: Observation) -> int:
        """Steps that battery and clock allow."""
        telemetry = observation["telemetry"].tolist()
        steps = round(telemetry[2] * self._task.battery_capacity)
        if len(telemetry) > 5:
            steps = min(steps, round(telemetry[5] * self._task.max_steps))
        return steps
