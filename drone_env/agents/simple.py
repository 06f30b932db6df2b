"""Agents without a plan: random actions, and greedy flight to the nearest parcel, whatever the battery."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import StatelessAgent
from drone_env.core.actions import N_ACTIONS
from drone_env.core.episode import Observation
from drone_env.core.seeds import map_key, next_key, task_key, uniform_below
from drone_env.core.tasks import TaskConfig
from drone_env.planning.greedy import greedy_actions

KEY = task_key("agent/random", 1)


class RandomAgent:
    """Uniformly random actions; equal seeds give equal actions."""

    stochastic = True

    def __init__(self, task: TaskConfig) -> None:
        self.config: Mapping[str, object] = {"agent": "random", "version": 1}
        self._key: Any = 0

    def reset(self, seed: int) -> None:
        """Start the sequence of actions of this seed."""
        self._key = map_key(KEY, seed)

    def act(self, observation: Observation) -> int:
        """The next action of the sequence."""
        self._key = next_key(self._key)
        return uniform_below(self._key, N_ACTIONS)

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Start the sequences of these seeds, int64[N]."""
        as_integers: Any = seeds  # arrays of 64-bit integers wrap like compiled integers
        self._key = map_key(KEY, as_integers)

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions of the sequences, int64[N]."""
        self._key = next_key(self._key)
        actions: Any = uniform_below(self._key, N_ACTIONS)
        return actions


class GreedyAgent(StatelessAgent):
    """Flies to the nearest target, on the cheapest path if terrain costs or blocks."""

    def __init__(self, task: TaskConfig) -> None:
        self.config: Mapping[str, object] = {"agent": "greedy", "version": 1}
        self.act_batch = partial(greedy_actions, task)
