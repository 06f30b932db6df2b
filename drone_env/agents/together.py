"""Many episodes flown together, each to its first end."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.batch import Batch
from drone_env.core.tasks import TaskConfig

ActBatch = Callable[[npt.NDArray[np.uint8], npt.NDArray[np.float32]], npt.NDArray[np.int64]]
"""From grids uint8[N, H, W] and telemetry float32[N, telemetry_size] to actions, int64[N]."""


class BatchResults(NamedTuple):
    """How n episodes ended, in the order of their seeds."""

    scores: npt.NDArray[np.float64]
    """float64[n], graded."""
    steps: npt.NDArray[np.int32]
    """int32[n], steps flown."""
    deliveries_done: npt.NDArray[np.int32]
    """int32[n], parcels delivered."""


def fly_together(task: TaskConfig, seeds: npt.NDArray[np.int64], act: ActBatch, stateless: bool) -> BatchResults:
    """Fly each map once.

    Args:
        task: The task.
        seeds: int64[n], the maps.
        act: Names the actions.
        stateless: Whether `act` holds no state for each episode; it is then asked for those alone that still fly.
    """
    n = len(seeds)
    results = BatchResults(np.zeros(n), np.zeros(n, np.int32), np.zeros(n, np.int32))
    flying, actions = np.ones(n, np.bool_), np.zeros(n, np.int64)
    batch = Batch(task, n)
    batch.reset(seeds)
    while flying.any():
        asked = flying if stateless else slice(None)
        actions[asked] = act(batch.grids[asked], batch.telemetry[asked])
        batch.step(actions)
        # Episodes that ended earlier fly on, over other maps: only the first end counts.
        first = flying[batch.ended]
        ended, finals = batch.ended[first], batch.finals()
        for column, name in zip(results, ("score", "steps", "deliveries"), strict=True):
            column[ended] = finals[name][first]
        flying[ended] = False
    return results
