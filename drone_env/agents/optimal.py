"""The agent that flies a best flight, from nothing but what it observes."""

from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode, Observation
from drone_env.core.tasks import TaskConfig
from drone_env.planning.from_observation import episode_of
from drone_env.planning.greedy import drone_positions
from drone_env.planning.optimal import best_actions

TARGET_TELEMETRY = (3, 4)
"""Where the target stands in the telemetry. Of equally near parcels it is the first by number, which nobody sees."""


class OptimalAgent:
    """Plans a best flight from what it sees and flies it; plans again when the world is not what it expected.

    Raises:
        TooLargeError: when it is to plan on a map that is too large to be solved.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.config: Mapping[str, object] = {"agent": "optimal", "version": 2}
        self._task = task
        self._plan: list[Action] = []
        self._expected: Episode | None = None
        self._plans: Iterator[npt.NDArray[np.int64]] | None = None

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
        self._plans = None

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions of the plans, int64[N]. The first call makes them: no parcel may be delivered yet."""
        if self._plans is None:
            make = self._plan_tours if self._task.uniform else self._plan_each
            self._plans = iter(make(grids, telemetry).T)
        return next(self._plans, np.full(len(grids), Action.WAIT))

    def _plan_each(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The actions of a best flight over each map, int64[N, max_steps], WAIT behind its end."""
        plans = np.full((len(grids), self._task.max_steps), Action.WAIT, np.int64)
        for plan, grid, values in zip(plans, grids, telemetry, strict=True):
            actions = best_actions(episode_of(self._task, {"grid": grid, "telemetry": values}))
            plan[: len(actions)] = actions
        return plans

    def _plan_tours(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The same where a best flight is a tour: all are planned together."""
        from drone_env.planning.tours import plan_tours  # compiles, which only batches are worth

        drones = drone_positions(self._task, telemetry)
        _, y, x = np.nonzero(grids == Cell.DELIVERY)
        parcels = np.stack([x, y], axis=1).reshape(len(grids), self._task.deliveries, 2)
        budgets = np.rint(telemetry[:, 2] * self._task.battery_capacity).astype(np.int64)
        if telemetry.shape[1] > 5:
            budgets = np.minimum(budgets, np.rint(telemetry[:, 5] * self._task.max_steps).astype(np.int64))
        return plan_tours(drones, parcels, budgets)


def _shows(episode: Episode, observation: Observation) -> bool:
    """Whether an episode shows this observation, whichever of the parcels is its target."""
    expected = episode.observation()
    own = [i for i in range(len(expected["telemetry"])) if i not in TARGET_TELEMETRY]
    return np.array_equal(expected["grid"], observation["grid"]) and np.array_equal(
        expected["telemetry"][own], observation["telemetry"][own]
    )
