"""The pilots of the page, agents and people."""

from inspect import cleandoc
from types import FunctionType
from typing import NamedTuple

from drone_env.agents import AGENTS, SHIPPED_AGENTS
from drone_env.flights.provenance import HUMAN

NETWORK, TRAINED = "pathqnet", "trained"
"""The pilots that fly by a PathQNet: the shipped one, and the one from the data folder."""


class Pilot(NamedTuple):
    """A pilot."""

    name: str
    summary: str
    network: str = ""
    """Key of `NETWORK_AGENTS`; empty for a pilot without a network."""
    trained: bool = False
    """Whether the network is in the data folder; shipped networks are not."""


BUILTIN_PILOTS: dict[str, Pilot] = {
    TRAINED: Pilot(
        "Trained here", "The network that you trained, from the data folder of this server.", "pathqnet", trained=True
    ),
    "trained-tournet": Pilot(
        "Tournet trained here", "The tour network that you trained, from the same folder.", "tournet", trained=True
    ),
    "trained-ppo": Pilot("PPO trained here", "The policy that you trained, from the same folder.", "ppo", trained=True),
    NETWORK: Pilot(
        "PathQNet", "The network that is shipped: sees the map, takes the action of the highest value.", "pathqnet"
    ),
    "tournet": Pilot(
        "Tournet", "A network that plans: chooses the parcel or pad to fly to next, and by which way.", "tournet"
    ),
    "ppo": Pilot(
        "PPO", "A policy that is shipped: sees the way to each parcel and pad, and learned from rewards.", "ppo"
    ),
    "greedy": Pilot("Greedy", "Flies to the nearest parcel, whatever its battery."),
    "nearest": Pilot(
        "Nearest neighbour", "A rule: the nearest parcel from which a pad stays in range; else it fills up."
    ),
    "beam": Pilot("Beam search", "Tries many orders of parcels and pads, and flies the best. No learning."),
    "optimal": Pilot("Optimal", "Plans a best flight over the whole map and flies it."),
    "random": Pilot("Random", "Takes any action; the floor that everybody must beat."),
    HUMAN: Pilot("You", "Arrow keys or the pad; space waits."),
}
COLOURS = len(BUILTIN_PILOTS) + 1
"""Colours of pilots on the page, `--pilot-1` and so on; registered agents share the last one."""


def all_pilots() -> dict[str, Pilot]:
    """`BUILTIN_PILOTS`, and the agents that plugins registered."""
    registered = {name: make for name, make in AGENTS.items() if name not in (*SHIPPED_AGENTS, *BUILTIN_PILOTS)}
    return BUILTIN_PILOTS | {name: Pilot(name, _summary(make)) for name, make in registered.items()}


def _summary(make: object) -> str:
    doc = make.__doc__ if isinstance(make, type | FunctionType) else None  # other objects inherit that of their type
    return cleandoc(doc or "An agent that a plugin of this server registered.").partition("\n\n")[0].replace("\n", " ")
