"""The agent that flies straight to the nearest parcel."""

from collections.abc import Mapping

from drone_env.core.state_manager import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.planning.greedy import greedy_action
from drone_env.planning.paths import require_uniform


class GreedyAgent:
    """Chases the current target and looks no further.

    Raises:
        UnsupportedTaskError: if the task is not `uniform`.
    """

    def __init__(self, task: TaskConfig) -> None:
        require_uniform(task)
        self.config: Mapping[str, object] = {"agent": "greedy", "version": 1}
        self._task = task

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> int:
        """The next action towards the current target."""
        return greedy_action(self._task, observation)
