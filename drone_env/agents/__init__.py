"""Agents, which choose actions. `make_agent` makes one by its name."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from drone_env.agents.base import Agent, BatchAgent
from drone_env.agents.named import agent_named, sb3_elsewhere, sb3_file
from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.agents.planned import OptimalAgent
from drone_env.agents.simple import GreedyAgent, RandomAgent
from drone_env.agents.tournet import TournetAgent, TournetSearchAgent
from drone_env.agents.weights_file import PATHQNET, TOURNET
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError, UnknownNameError


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
SHIPPED_AGENTS = tuple(AGENTS)
"""The names of those of this package; the others were registered."""


def register_agent(name: str, make: Callable[[TaskConfig], Agent]) -> None:
    """Make an agent known by its name everywhere; `make`, such as its class, makes one for a task.

    Registering the same again changes nothing.

    Raises:
        InvalidValueError: if another agent has the name, or it has a colon, which begins the file of a network.
    """
    if ":" in name or AGENTS.get(name, make) != make:
        raise InvalidValueError(
            f"agent {name!r}: the name has a colon or is that of another agent: {', '.join(AGENTS)}"
        )
    AGENTS[name] = make


def network_file(name: str) -> tuple[str, Path] | None:
    """The agent and the file that `NAME:FILE` names; None where a name is not of that form."""
    agent, colon, file = name.partition(":")
    return (agent, Path(file)) if colon and agent in NETWORK_AGENTS else None


def file_of(name: str) -> Path | None:
    """The file that the name of an agent names; None where it names none."""
    network = network_file(name)
    return sb3_file(name) if network is None else network[1]


def elsewhere(name: str, file: Path) -> str:
    """The name that an agent whose name names a file has where that file lies elsewhere."""
    network = network_file(name)
    return sb3_elsewhere(name, file) if network is None else f"{network[0]}:{file}"


def make_agent(name: str, task: str | TaskConfig) -> Agent:
    """A new agent for a task, from a name that commands take as well.

    It is one of `AGENTS`; or `pathqnet:FILE`, by the network in a file instead of the shipped one, as all of
    `NETWORK_AGENTS` can fly; or `MODULE:NAME`, a class or a function of your own; or `FILE.zip:WRAPPER`, a policy that
    Stable-Baselines3 saved, behind the wrapper of observations that it was trained behind (`FILE.zip` for none), with
    `:sampled` at the end where it is to draw its actions. Reading such a file runs code that it holds: see that you
    trust it.

    Raises:
        UnknownNameError: if there is no such agent, task or wrapper; the message lists the valid names.
        InvalidValueError: if there is no such module, or what it names cannot fly.
        UnsupportedTaskError: if the agent cannot fly that task.
        OSError: if the file cannot be read.
        CheckpointError: if it holds no network, or none for that task.
    """
    task = get_task(task)
    network = network_file(name)
    if network is not None:
        agent, file = network
        return NETWORK_AGENTS[agent].make(task, file)
    if name in list(AGENTS):
        return AGENTS[name](task)
    made = agent_named(name, task)
    if made is None:
        raise UnknownNameError("agent", name, [*AGENTS, "MODULE:NAME", "FILE.zip:WRAPPER"])
    return made


__all__ = [
    "AGENTS",
    "NETWORK_AGENTS",
    "SHIPPED_AGENTS",
    "Agent",
    "BatchAgent",
    "GreedyAgent",
    "OptimalAgent",
    "PathQNetAgent",
    "RandomAgent",
    "TournetAgent",
    "TournetSearchAgent",
    "elsewhere",
    "file_of",
    "make_agent",
    "network_file",
    "register_agent",
]
