"""How well a network flies by itself, on maps that training never sees."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.agents.together import fly_together
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TaskConfig
from drone_env.planning.optimal import solve

Values = Callable[[npt.NDArray[np.uint8], npt.NDArray[np.float32]], npt.NDArray[np.float32]]
"""From grids uint8[N, H, W] and telemetry float32[N, telemetry_size] to the values of the actions, float32[N, 5]."""


class Validation(NamedTuple):
    """The result of flying the validation maps."""

    score: float
    """Mean graded score."""
    optimum: float
    """Mean exact optimum of the same maps."""
    success: float
    """Share of maps on which everything was delivered."""


class Validator:
    """Flies the first maps of the validation split.

    Args:
        task: The task.
        maps: How many.
    """

    def __init__(self, task: TaskConfig, maps: int) -> None:
        self._task = task
        self._seeds = np.array(split_seeds("validation", maps))
        self.optimum = float(np.mean([solve(task, seed).score for seed in self._seeds.tolist()]))

    def validate(self, values: Values) -> Validation:
        """Fly each map once, always by the action of the highest value."""
        ends = fly_together(self._task, self._seeds, lambda grids, seen: values(grids, seen).argmax(axis=1), True)
        success = ends.deliveries_done == self._task.deliveries
        return Validation(float(ends.scores.mean()), self.optimum, float(success.mean()))
