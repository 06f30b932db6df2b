"""The agent that plans a best flight and flies it."""

from collections.abc import Mapping

import numpy as np

from drone_env.core.actions import Action
from drone_env.core.episode import Episode, Observation
from drone_env.core.tasks import TaskConfig
from drone_env.planning.from_observation import episode_of
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


def _shows(episode: Episode, observation: Observation) -> bool:
    """Whether an episode has this observation, whichever parcel is its target."""
    expected = episode.observation()
    own = [i for i in range(len(expected["telemetry"])) if i not in TARGET_TELEMETRY]
    return np.array_equal(expected["grid"], observation["grid"]) and np.array_equal(
        expected["telemetry"][own], observation["telemetry"][own]
    )
