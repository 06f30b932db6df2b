"""Agents: everything that can fly by itself. A new agent is one more entry in `AGENTS`."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from drone_env.agents.base import Agent, BatchAgent
from drone_env.agents.greedy import GreedyAgent
from drone_env.agents.optimal import OptimalAgent
from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.agents.random import RandomAgent
from drone_env.agents.tournet import TournetAgent
from drone_env.agents.tournet_search import TournetSearchAgent
from drone_env.agents.weights_file import PATHQNET, TOURNET
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import UnknownNameError


class NetworkAgent(NamedTuple):
    """An agent that flies by a network."""

    network: str
    """Whose parameters its file holds, as `weights_file.network_of` tells it."""
    make: Callable[..., Agent]
    """From the task and the file; without a file it flies by the shipped one."""


NETWORK_AGENTS: dict[str, NetworkAgent] = {
    "pathqnet": NetworkAgent(PATHQNET, PathQNetAgent),
    "tournet": NetworkAgent(TOURNET, TournetAgent),
    "tournet-search": NetworkAgent(TOURNET, TournetSearchAgent),
    "tournet-search-64": NetworkAgent(TOURNET, partial(TournetSearchAgent, plans=64)),
}
"""The agents that fly by the network in a file, `NAME:FILE`, as well as by a shipped one."""
AGENTS: dict[str, Callable[[TaskConfig], Agent]] = {
    "random": RandomAgent,
    "greedy": GreedyAgent,
    "optimal": OptimalAgent,
    **{name: agent.make for name, agent in NETWORK_AGENTS.items()},
}
"""What makes each agent for a task, by its name."""


def network_file(name: str) -> tuple[str, Path] | None:
    """The agent and the file that `NAME:FILE` names; None where a name is not of that form."""
    agent, colon, file = name.partition(":")
    return (agent, Path(file)) if colon and agent in NETWORK_AGENTS else None


def make_agent(name: str, task: str | TaskConfig) -> Agent:
    """A new agent for a task. `pathqnet` flies by the shipped network, `pathqnet:FILE` by the one in a file.

    So do the others of `NETWORK_AGENTS`.

    Raises:
        UnknownNameError: if there is no such agent or task; the message lists the valid names.
        UnsupportedTaskError: if the agent cannot fly that task.
        OSError: if the file cannot be read.
        CheckpointError: if it holds no network for that task.
    """
    named = network_file(name)
    if named is not None:
        agent, file = named
        return NETWORK_AGENTS[agent].make(get_task(task), file)
    if name not in list(AGENTS):
        raise UnknownNameError("agent", name, AGENTS)
    return AGENTS[name](get_task(task))


__all__ = [
    "AGENTS",
    "NETWORK_AGENTS",
    "Agent",
    "BatchAgent",
    "GreedyAgent",
    "OptimalAgent",
    "PathQNetAgent",
    "RandomAgent",
    "TournetAgent",
    "TournetSearchAgent",
    "make_agent",
    "network_file",
]
