"""The one protocol of everything that flies."""

from collections.abc import Mapping
from typing import Protocol

from drone_env.core.state_manager import Observation


class Agent(Protocol):
    """Turns observations into actions. One agent flies one episode at a time, on one task."""

    @property
    def config(self) -> Mapping[str, object]:
        """All that decides how the agent flies, as JSON values: part of the identity of its results."""
        ...

    def reset(self, seed: int) -> None:
        """Forget the last episode; `seed`, the number of the map, is the source of any random choice."""
        ...

    def act(self, observation: Observation) -> int:
        """The next action, 0 to 4."""
        ...
