"""The agent that chooses blindly."""

from collections.abc import Mapping

from drone_env.core.actions import N_ACTIONS
from drone_env.core.seeds import map_key, next_key, task_key, uniform_below
from drone_env.core.state_manager import Observation
from drone_env.core.tasks import TaskConfig

KEY = task_key("agent/random", 1)


class RandomAgent:
    """Each action is drawn uniformly from all five; the same map gets the same actions in every run."""

    def __init__(self, task: TaskConfig) -> None:
        self.config: Mapping[str, object] = {"agent": "random", "version": 1}
        self._key = 0

    def reset(self, seed: int) -> None:
        """Start the sequence of actions that belongs to map `seed`."""
        self._key = map_key(KEY, seed)

    def act(self, observation: Observation) -> int:
        """The next action of the sequence."""
        self._key = next_key(self._key)
        return uniform_below(self._key, N_ACTIONS)
