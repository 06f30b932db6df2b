"""Batched rollouts: many episodes in parallel, each to its first end."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import named_failures
from drone_env.core.batch import Batch
from drone_env.core.tasks import TaskConfig

ActBatch = Callable[[npt.NDArray[np.uint8], npt.NDArray[np.float32]], npt.NDArray[np.int64]]
"""From grids uint8[N, H, W] and telemetry float32[N, telemetry_size] to actions, int64[N]."""


class BatchResults(NamedTuple):
    """The results of n episodes, in the order of their seeds."""

    scores: npt.NDArray[np.float64]
    """float64[n], graded."""
    steps: npt.NDArray[np.int32]
    """int32[n], steps flown."""
    deliveries_done: npt.NDArray[np.int32]
    """int32[n], parcels delivered."""


def rollout_batch(
    task: TaskConfig,
    seeds: npt.NDArray[np.int64],
    act: ActBatch,
    stateless: bool,
    name: str = "network",
    reset: Callable[[], None] = lambda: None,
) -> BatchResults:
    """Fly each map once.

    Args:
        task: The task.
        seeds: int64[n], the maps.
        act: Returns the actions.
        stateless: Whether `act` keeps no state per episode; it then gets only episodes that still fly.
        name: The agent's name in errors.
        reset: Called before the first step.
    """
    n, step = len(seeds), 0
    results = BatchResults(np.zeros(n), np.zeros(n, np.int32), np.zeros(n, np.int32))
    flying, actions = np.ones(n, np.bool_), np.zeros(n, np.int64)
    with named_failures(name, task, lambda: f"maps {seeds[0]} to {seeds[-1]}, step {step}"):
        reset()
        batch = Batch(task, n)
        batch.reset(seeds)
        while flying.any():
            step += 1
            active = flying if stateless else slice(None)
            actions[active] = act(batch.grids[active], batch.telemetry[active])
            batch.step(actions)
            # Ended episodes are reset to other maps: only the first end counts.
            first = flying[batch.ended]
            ended, finals = batch.ended[first], batch.finals()
            for column, figure in zip(results, ("score", "steps", "deliveries"), strict=True):
                column[ended] = finals[figure][first]
            flying[ended] = False
    return results
