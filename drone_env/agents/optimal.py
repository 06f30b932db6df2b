"""The agent that plans a best flight and flies it."""

from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Action
from drone_env.core.episode import Episode, Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.planning.from_observation import episode_of, require_observations
from drone_env.planning.optimal import best_actions

TARGET_TELEMETRY = (3, 4)
"""Indices of the target in the telemetry. Ties break by the parcel's number, which no observation contains."""


class OptimalAgent:
    """Plans a best flight from the observation and flies it; plans again after an unexpected observation.

    Args:
        task: The task.

    Raises:
        TooLargeError: when it is to plan on a map that is too large to be solved.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.config: Mapping[str, object] = {"agent": "optimal", "version": 2}
        self._task = task
        self._plan: list[Action] = []
        self._expected: Episode | None = None
        self._flights = 0
        self._plans: Iterator[npt.NDArray[np.int64]] | None = None

    def reset(self, seed: int) -> None:
        """Forget the last flight."""
        self._plan, self._expected = [], None

    def act(self, observation: Observation) -> int:
        """The next action of the plan; WAIT when it is at its end."""
        if self._expected is None or not _shows(self._expected, observation):
            self._expected = episode_of(self._task, observation)
            self._plan = list(best_actions(self._expected))
        action = self._plan.pop(0) if self._plan else Action.WAIT
        self._expected.step(action)
        return action

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Forget the last flights."""
        self._flights, self._plans = len(seeds), None

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions of the plans, int64[N]. The first call makes them: no parcel may be delivered yet.

        Raises:
            InvalidValueError: if they are no observations of the task, or not one for each seed of `reset_batch`.
        """
        if len(grids) != self._flights:
            raise InvalidValueError(f"reset_batch got {self._flights} seeds, act_batch got {len(grids)} observations")
        if self._plans is None:
            require_observations(self._task, grids, telemetry)
            plans = np.full((len(grids), self._task.max_steps), Action.WAIT, np.int64)
            for plan, grid, values in zip(plans, grids, telemetry, strict=True):
                actions = best_actions(episode_of(self._task, {"grid": grid, "telemetry": values}))
                plan[: len(actions)] = actions
            self._plans = iter(plans.T)
        return next(self._plans, np.full(len(grids), Action.WAIT))


def _shows(episode: Episode, observation: Observation) -> bool:
    """Whether an episode has this observation, whichever parcel is its target."""
    expected = episode.observation()
    own = [i for i in range(len(expected["telemetry"])) if i not in TARGET_TELEMETRY]
    return np.array_equal(expected["grid"], observation["grid"]) and np.array_equal(
        expected["telemetry"][own], observation["telemetry"][own]
    )
