"""The agent that flies a best flight, from nothing but what it observes."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode, Observation
from drone_env.core.tasks import TaskConfig
from drone_env.planning.from_observation import episode_of
from drone_env.planning.greedy import positions
from drone_env.planning.optimal import best_actions
from drone_env.planning.paths import towards_batch

TARGET_TELEMETRY = (3, 4)
"""Where the target stands in the telemetry. Of equally near parcels it is the first by number, which nobody sees."""


class OptimalAgent:
    """Plans a best flight from what it sees and flies it; plans again when the world is not what it expected.

    Raises:
        TooLargeError: when it is to plan on a map that is too large to be solved.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.config: Mapping[str, object] = {"agent": "optimal", "version": 1}
        self._task = task
        self._plan: list[Action] = []
        self._expected: Episode | None = None
        self._plans: npt.NDArray[np.int64] | None = None
        self._tours: npt.NDArray[np.int64] | None = None
        self._next = np.zeros(0, np.int64)

    def reset(self, seed: int) -> None:
        """Forget the last flight."""
        self._plan, self._expected = [], None

    def act(self, observation: Observation) -> int:
        """The next action of the plan; WAIT when no parcel is left within reach."""
        if self._expected is None or not _shows(self._expected, observation):
            self._expected = episode_of(self._task, observation)
            self._plan = best_actions(self._expected)
        action = self._plan.pop(0) if self._plan else Action.WAIT
        self._expected.step(action)
        return action

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Forget the last flights."""
        self._plans = self._tours = None

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions of the plans, int64[N]. The first call makes them: no parcel may be delivered yet."""
        if self._task.uniform:
            return self._act_on_tours(grids, telemetry)
        if self._plans is None:
            self._plans = np.full((len(grids), self._task.max_steps + 1), Action.WAIT, np.int64)
            self._next = np.zeros(1, np.int64)
            for i, plan in enumerate(self._plans):
                actions = best_actions(episode_of(self._task, {"grid": grids[i], "telemetry": telemetry[i]}))
                plan[: len(actions)] = actions
        self._next += 1
        return self._plans[:, self._next[0] - 1]

    def _act_on_tours(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The same where a plan is a tour: all are planned together."""
        drones, _ = positions(self._task, telemetry)
        if self._tours is None:
            self._tours = self._plan_tours(grids, telemetry, drones)
            self._next = np.zeros(len(grids), np.int64)
        episodes = np.arange(len(grids))
        for _ in range(self._task.deliveries):
            x, y = self._tours[episodes, self._next].T
            self._next += (x >= 0) & (grids[episodes, y, x] != Cell.DELIVERY)
        stops = self._tours[episodes, self._next]
        return towards_batch(drones, np.where(stops >= 0, stops, drones))

    def _plan_tours(
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


def _shows(episode: Episode, observation: Observation) -> bool:
    """Whether an episode shows this observation, whichever of the parcels is its target."""
    expected = episode.observation()
    own = [i for i in range(len(expected["telemetry"])) if i not in TARGET_TELEMETRY]
    return np.array_equal(expected["grid"], observation["grid"]) and np.array_equal(
        expected["telemetry"][own], observation["telemetry"][own]
    )
