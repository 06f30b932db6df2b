"""A plugin that registers an agent."""

from drone_env.agents import GreedyAgent, register_agent
from drone_env.core.tasks import TaskConfig
from drone_env.errors import UnsupportedTaskError


class Homebrew(GreedyAgent):
    """Flies as I think
    it should.

    More about it.
    """

    def __init__(self, task: TaskConfig) -> None:
        if task.pads:
            raise UnsupportedTaskError("it does not know pads")
        super().__init__(task)


register_agent("homebrew", Homebrew)
