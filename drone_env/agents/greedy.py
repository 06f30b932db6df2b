"""The agent that flies to the nearest parcel."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.planning.greedy import greedy_action, greedy_actions


class GreedyAgent:
    """Chases the nearest target and looks no further; where terrain costs or blocks, by the cheapest way."""

    stateless = True

    def __init__(self, task: TaskConfig) -> None:
        self.config: Mapping[str, object] = {"agent": "greedy", "version": 1}
        self._task = task

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> int:
        """The next action towards the nearest target."""
        return greedy_action(self._task, observation)

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Nothing to forget."""

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions towards the nearest targets, int64[N]."""
        return greedy_actions(self._task, grids, telemetry)
