"""Agents, which choose actions. A new one is a class and its line in `AGENTS`; `make_agent` makes it by its name."""

from collections.abc import Callable
from pathlib import Path

from drone_env.agents.base import Agent
from drone_env.agents.custom import MODULE_AND_NAME, as_agent, imported
from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.agents.planned import BeamAgent, NearestAgent, OptimalAgent
from drone_env.agents.ppo import PpoAgent
from drone_env.agents.simple import GreedyAgent, RandomAgent
from drone_env.agents.tournet import TournetAgent
from drone_env.agents.weights_file import local_file
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError, UnknownNameError

NETWORK_AGENTS: dict[str, Callable[..., Agent]] = {
    "pathqnet": PathQNetAgent,
    "ppo": PpoAgent,
    "tournet": TournetAgent,
}
"""The agents with a network, made from a task and the file of `NAME:FILE`."""
AGENTS: dict[str, Callable[[TaskConfig], Agent]] = {
    "random": RandomAgent,
    "greedy": GreedyAgent,
    "nearest": NearestAgent,
    "beam": BeamAgent,
    "optimal": OptimalAgent,
    **NETWORK_AGENTS,
}
"""The factory of each agent, by its name."""
SHIPPED_AGENTS = tuple(AGENTS)
"""The names of this package's agents; others are registered."""


def register_agent(name: str, make: Callable[[TaskConfig], Agent]) -> None:
    """Register an agent by its name; `make`, such as its class, makes one for a task.

    Registering the same again changes nothing.

    Raises:
        InvalidValueError: if another agent has the name, or it has a colon, which separates the file of a network.
    """
    if ":" in name or AGENTS.get(name, make) != make:
        raise InvalidValueError(
            f"agent {name!r}: the name has a colon or is that of another agent: {', '.join(AGENTS)}"
        )
    AGENTS[name] = make


def network_file(name: str) -> tuple[str, Path] | None:
    """The agent and the file of `NAME:FILE`; None if a name is not of that form."""
    agent, colon, file = name.partition(":")
    return (agent, Path(file)) if colon and agent in NETWORK_AGENTS else None


def file_of(name: str) -> Path | None:
    """The file in the name of an agent; None if there is none."""
    network = network_file(name)
    return None if network is None else network[1]


def rebase_agent_path(name: str, file: Path) -> str:
    """The name of an agent after its file, if it has one, is moved."""
    network = network_file(name)
    return name if network is None else f"{network[0]}:{file}"


def make_agent(name: str, task: str | TaskConfig) -> Agent:
    """Make an agent for a task by its name, as commands take it.

    Names are those of `AGENTS`; `beam:WIDTH`; `pathqnet:FILE`, the network in a file, or `pathqnet:USER/NAME` of the
    Hub, likewise for all `NETWORK_AGENTS`; `MODULE:NAME`, your own class or function, or a model of Stable-Baselines3
    that the module loads.

    Raises:
        UnknownNameError: if there is no such agent or task; the message lists the valid names.
        InvalidValueError: if there is no such module, or its member cannot fly.
        UnsupportedTaskError: if the agent cannot fly that task.
        OSError: if the file cannot be read.
        CheckpointError: if it contains no network for that task.
    """
    if isinstance(task, str):
        task = get_task(task)
    if name in list(AGENTS):
        return AGENTS[name](task)
    if name.startswith("beam:"):
        return BeamAgent(task, name.removeprefix("beam:"))
    if network := network_file(name):
        return NETWORK_AGENTS[network[0]](task, local_file(network[1]))
    if MODULE_AND_NAME.fullmatch(name):
        return as_agent(imported(name), task)
    raise UnknownNameError("agent", name, [*AGENTS, "MODULE:NAME"])
