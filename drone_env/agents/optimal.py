"""The agent that flies the shortest tour, from nothing but what it observes."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.state_manager import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.planning.greedy import drone_position, positions
from drone_env.planning.optimal import shortest_tour
from drone_env.planning.paths import Position, require_uniform, towards, towards_batch


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
        self._tours: npt.NDArray[np.int64] | None = None
        self._next = np.zeros(0, np.int64)

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

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Forget the last tours."""
        self._tours = None

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions of the tours, int64[N]. The first call plans them: no parcel may be delivered yet."""
        drones, _ = positions(self._task, telemetry)
        if self._tours is None:
            self._tours = self._plan(grids, telemetry, drones)
            self._next = np.zeros(len(grids), np.int64)
        episodes = np.arange(len(grids))
        for _ in range(self._task.deliveries):
            x, y = self._tours[episodes, self._next].T
            self._next += (x >= 0) & (grids[episodes, y, x] != Cell.DELIVERY)
        stops = self._tours[episodes, self._next]
        return towards_batch(drones, np.where(stops >= 0, stops, drones))

    def _plan(
        self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32], drones: npt.NDArray[np.int64]
    ) -> npt.NDArray[np.int64]:
        """(x, y) of the stops of each tour, int64[N, D + 1, 2], -1 behind its end."""
        from drone_env.planning.tours import plan_tours  # compiles, which only batches are worth

        n, deliveries = len(grids), self._task.deliveries
        _, y, x = np.nonzero(grids == Cell.DELIVERY)
        parcels = np.stack([x, y], axis=1).reshape(n, deliveries, 2)
        budgets = np.rint(telemetry[:, 2] * self._task.battery_capacity).astype(np.int64)
        if telemetry.shape[1] > 5:
            budgets = np.minimum(budgets, np.rint(telemetry[:, 5] * self._task.max_steps).astype(np.int64))
        orders = plan_tours(drones, parcels, budgets)
        stops = np.take_along_axis(parcels, np.maximum(orders, 0)[:, :, None], axis=1)
        stops[orders < 0] = -1
        return np.concatenate([stops, np.full((n, 1, 2), -1)], axis=1)
