"""The agent that flies a best flight, from nothing but what it observes."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from drone_env.agents.planned import PlannedAgent
from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.planning.from_observation import drone_positions, episode_of
from drone_env.planning.optimal import best_actions


class OptimalAgent(PlannedAgent):
    """Plans a best flight and flies it.

    Raises:
        TooLargeError: when it is to plan on a map that is too large to be solved.
    """

    def __init__(self, task: TaskConfig) -> None:
        super().__init__(task)
        self.config: Mapping[str, object] = {"agent": "optimal", "version": 2}

    def plan(self, episode: Episode) -> list[Action]:
        """The actions of a best flight."""
        return best_actions(episode)

    def plan_all(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The actions of a best flight over each map, int64[N, T]."""
        return (self._plan_tours if self.task.uniform else self._plan_each)(grids, telemetry)

    def _plan_each(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        plans = np.full((len(grids), self.task.max_steps), Action.WAIT, np.int64)
        for plan, grid, values in zip(plans, grids, telemetry, strict=True):
            actions = best_actions(episode_of(self.task, {"grid": grid, "telemetry": values}))
            plan[: len(actions)] = actions
        return plans

    def _plan_tours(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The same where a best flight is a tour: all are planned together."""
        from drone_env.planning.tours import plan_tours  # compiles, which only batches are worth

        drones = drone_positions(self.task, grids, telemetry)
        _, y, x = np.nonzero(grids == Cell.DELIVERY)
        parcels = np.stack([x, y], axis=1).reshape(len(grids), self.task.deliveries, 2)
        budgets = np.rint(telemetry[:, 2] * self.task.battery_capacity).astype(np.int64)
        if telemetry.shape[1] > 5:
            budgets = np.minimum(budgets, np.rint(telemetry[:, 5] * self.task.max_steps).astype(np.int64))
        return plan_tours(drones, parcels, budgets)
