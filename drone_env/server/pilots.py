"""Who can fly a mission on the page: the agents, and whoever sits before it."""

from typing import NamedTuple

from drone_env.agents import make_agent
from drone_env.agents.base import Agent
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.server.predict import Networks

HUMAN = "human"
NETWORK = "pathqnet"


class Pilot(NamedTuple):
    """One who flies."""

    name: str
    summary: str


PILOTS: dict[str, Pilot] = {
    NETWORK: Pilot("PathQNet", "The trained network: sees the map, takes the action of the highest value."),
    "greedy": Pilot("Greedy", "Flies to the nearest parcel and looks no further."),
    "optimal": Pilot("Optimal", "Plans a best flight over the whole map and flies it."),
    "random": Pilot("Random", "Takes any action; the floor that everybody must beat."),
    HUMAN: Pilot("You", "Arrow keys or the pad; space waits."),
}


def tasks_of(pilot: str, networks: Networks) -> list[str]:
    """Ids of the tasks that a pilot can fly."""
    return [task.id for task in TASKS.values() if pilot != NETWORK or networks.has(task)]


def agent_of(pilot: str, task: TaskConfig, networks: Networks) -> Agent | None:
    """A new agent that flies as a pilot does, None for a person.

    Raises:
        UnknownNameError: if there is no such pilot.
        OSError: if there is no network for the task.
        CheckpointError: if its file holds none that fits.
    """
    if pilot == HUMAN:
        return None
    return networks.pilot(task) if pilot == NETWORK else make_agent(pilot, task)
