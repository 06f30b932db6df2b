"""The one protocol of everything that flies."""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from drone_env.core.episode import Observation


class Agent(Protocol):
    """Turns observations into actions. One agent flies one episode at a time, on one task.

    One that draws lots says so by `stochastic = True`: an evaluation may then fly each map several times.
    """

    @property
    def config(self) -> Mapping[str, object]:
        """All that decides how the agent flies, as JSON values: part of the identity of its results."""
        ...

    def reset(self, seed: int) -> None:
        """Forget the last episode; `seed` is the source of any random choice.

        It is the number of the map, or, where a stochastic agent flies the same map again, another one.
        """
        ...

    def act(self, observation: Observation) -> int:
        """The next action, 0 to 4."""
        ...


@runtime_checkable
class BatchAgent(Protocol):
    """An agent that can also fly N episodes of its task together, and then chooses as it would for each alone.

    One that holds no state for each episode says so by `stateless = True`: it may be shown those alone that still fly.
    """

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Forget the last episodes; `seeds`, int64[N], are the sources of their random choices, as in `reset`."""
        ...

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N], for grids uint8[N, H, W] and telemetry float32[N, telemetry_size].

        What it chooses for an episode that has ended is not used.
        """
        ...
