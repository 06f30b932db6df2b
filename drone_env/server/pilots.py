"""Who can fly on the page: the agents, and the person at the page."""

from typing import NamedTuple

from drone_env.agents import make_agent
from drone_env.agents.base import Agent
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import UnknownNameError
from drone_env.server.predict import NETWORK, SOURCES, TRAINED, Networks

HUMAN = "human"


class Pilot(NamedTuple):
    """One who flies."""

    name: str
    summary: str


PILOTS: dict[str, Pilot] = {
    TRAINED: Pilot("Trained here", "The network that you trained, from the data folder of this server."),
    "trained-tournet": Pilot("Tournet trained here", "The tour network that you trained, from the same folder."),
    NETWORK: Pilot("PathQNet", "The network that is shipped: sees the map, takes the action of the highest value."),
    "tournet": Pilot("Tournet", "A network that plans: chooses the parcel or pad to fly to next, and by which way."),
    "greedy": Pilot("Greedy", "Flies to the nearest parcel and looks no further."),
    "optimal": Pilot("Optimal", "Plans a best flight over the whole map and flies it."),
    "tournet-search": Pilot("Tournet search", "Tries eight plans of Tournet before it starts, and flies the best."),
    "random": Pilot("Random", "Takes any action; the floor that everybody must beat."),
    HUMAN: Pilot("You", "Arrow keys or the pad; space waits."),
}


def called(agent: str) -> str:
    """What people call who has flown: a pilot, a person, or whatever a record names."""
    return "A person" if agent == HUMAN else PILOTS[agent].name if agent in PILOTS else agent


def tasks_of(pilot: str, networks: Networks) -> list[str]:
    """Ids of the tasks that a pilot can fly."""
    return [task.id for task in TASKS.values() if pilot not in SOURCES or networks.flies(pilot, task)]


def agent_of(pilot: str, task: TaskConfig, networks: Networks) -> Agent | None:
    """A new agent that flies as a pilot does, None for a person.

    Raises:
        UnknownNameError: if there is no such pilot.
        UnsupportedTaskError: if there is no network for the task.
        CheckpointError: if its file holds none that fits.
        TooLargeError: if a map of the task is too large for the pilot to look at.
        OSError: if the file can no longer be read.
    """
    if pilot not in PILOTS:
        raise UnknownNameError("pilot", pilot, PILOTS)
    if pilot == HUMAN:
        return None
    return networks.agent(pilot, task) if pilot in SOURCES else make_agent(pilot, task)
