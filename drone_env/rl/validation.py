"""How well a network flies by itself, on maps that training never sees."""

import math
from typing import NamedTuple

import numpy as np

from drone_env.agents.together import ActBatch, fly_together
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TaskConfig
from drone_env.planning.optimal import best_of


class Validation(NamedTuple):
    """The result of flying the validation maps."""

    score: float
    """Mean graded score."""
    optimum: float
    """Mean exact optimum of the same maps; NaN where one of them is too large to be solved."""
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
        best = [best_of(task, seed) for seed in self._seeds.tolist()]
        self.optimum = float(np.mean([math.nan if one is None else one.score for one in best]))

    def validate(self, act: ActBatch) -> Validation:
        """Fly each map once; `act` holds no state for each episode."""
        ends = fly_together(self._task, self._seeds, act, stateless=True)
        success = ends.deliveries_done == self._task.deliveries
        return Validation(float(ends.scores.mean()), self.optimum, float(success.mean()))
