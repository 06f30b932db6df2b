"""Agents: everything that can fly by itself. A new agent is one more entry in `AGENTS`."""

from collections.abc import Callable
from pathlib import Path

from drone_env.agents.base import Agent, BatchAgent
from drone_env.agents.greedy import GreedyAgent
from drone_env.agents.optimal import OptimalAgent
from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.agents.random import RandomAgent
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import UnknownNameError

AGENTS: dict[str, Callable[[TaskConfig], Agent]] = {
    "random": RandomAgent,
    "greedy": GreedyAgent,
    "optimal": OptimalAgent,
    "pathqnet": PathQNetAgent,
}
"""What makes each agent for a task, by its name."""
NETWORK_PREFIX = "pathqnet:"


def make_agent(name: str, task: str | TaskConfig) -> Agent:
    """A new agent for a task. `pathqnet` flies by the shipped network, `pathqnet:FILE` by the one in a file.

    Raises:
        UnknownNameError: if there is no such agent or task; the message lists the valid names.
        UnsupportedTaskError: if the agent cannot fly that task.
        OSError: if the file cannot be read.
        CheckpointError: if it holds no network for that task.
    """
    if name.startswith(NETWORK_PREFIX):
        return PathQNetAgent(get_task(task), Path(name.removeprefix(NETWORK_PREFIX)))
    if name not in list(AGENTS):
        raise UnknownNameError("agent", name, AGENTS)
    return AGENTS[name](get_task(task))


__all__ = ["AGENTS", "Agent", "BatchAgent", "GreedyAgent", "OptimalAgent", "PathQNetAgent", "RandomAgent", "make_agent"]
