"""The pilots of the page: agents and people. The provenance of a flight: the pilots of its steps."""

import logging
import re
from collections.abc import Callable
from functools import lru_cache
from inspect import cleandoc
from types import FunctionType
from typing import NamedTuple

from typing_extensions import Self

from drone_env.agents import AGENTS, SHIPPED_AGENTS, make_agent
from drone_env.agents.base import Agent
from drone_env.core.tasks import TaskConfig
from drone_env.errors import CheckpointError, TooLargeError, UnknownNameError, UnsupportedTaskError
from drone_env.server.predict import NETWORK, SOURCES, TRAINED, Networks

log = logging.getLogger(__name__)
HUMAN = "human"


class Pilot(NamedTuple):
    """A pilot."""

    name: str
    summary: str


OURS: dict[str, Pilot] = {
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


COLOURS = len(OURS) + 3
"""Colours of pilots on the page, `--pilot-1` and so on; further agents share the last one."""


def all_pilots() -> dict[str, Pilot]:
    """`OURS`, and the agents that plugins registered."""
    registered = {name: make for name, make in AGENTS.items() if name not in (*SHIPPED_AGENTS, *OURS)}
    return OURS | {name: Pilot(name, _summary(make)) for name, make in registered.items()}


def _summary(make: object) -> str:
    doc = make.__doc__ if isinstance(make, type | FunctionType) else None  # other objects inherit that of their type
    return cleandoc(doc or "An agent that a plugin of this server registered.").partition("\n\n")[0].replace("\n", " ")


HELP = {(True, False): "with values", (False, True): "with undo", (True, True): "with values and undo"}
PROVENANCE = re.compile(
    f"(?P<pilot>.+?)( (?P<help>{'|'.join(HELP.values())}))?( from step (?P<forked_at>[1-9][0-9]*) of (?P<of>.+))?"
)


class Provenance(NamedTuple):
    """The pilots of a flight, as the `agent` of its session and record: `human with undo from step 20 of pathqnet`.

    The format is a pilot; then ` with values`, ` with undo` or ` with values and undo` if a person used them; then, for
    a fork, ` from step N of ` and the provenance of the first N steps. Flights of different provenance are counted
    separately.
    """

    pilot: str
    """One of `all_pilots`, or any other agent of a record."""
    values: bool = False
    """Whether a person turned values on in flight."""
    undo: bool = False
    """Whether a person took back steps."""
    forked_at: int | None = None
    """The number of steps that others flew, 1 or more; None without a fork."""
    of: str | None = None
    """The provenance of these steps; None without a fork."""

    @classmethod
    def parse(cls, agent: str) -> Self:
        """The provenance that an `agent` contains; any text that has not its format is the name of a pilot."""
        match = PROVENANCE.fullmatch(agent)
        if match is None:
            return cls(agent)
        values, undo = next((used for used, words in HELP.items() if words == match["help"]), (False, False))
        step = None if match["of"] is None else int(match["forked_at"])
        return cls(match["pilot"], values, undo, step, match["of"])

    @classmethod
    def of_fork(cls, pilot: str, step: int, of: str) -> Self:
        """The provenance of a fork.

        A pilot that forks its own flight continues it; for a person this counts as undo. From step 0 a person's own
        flight starts again with its provenance.

        Args:
            pilot: The pilot from this step on.
            step: The number of steps of the first flight.
            of: The provenance of that flight.
        """
        before = cls.parse(of)
        while before.forked_at is not None and before.of is not None and step <= before.forked_at:
            before = cls.parse(before.of)
        if step == 0:
            return before if before.pilot == pilot else cls(pilot)
        if before.pilot == pilot:
            return before._replace(undo=before.undo or pilot == HUMAN)
        return cls(pilot, forked_at=step, of=str(before))

    def __str__(self) -> str:
        fork = None if self.of is None else f"from step {self.forked_at} of {self.of}"
        return " ".join(part for part in (self.pilot, HELP.get((self.values, self.undo)), fork) if part is not None)


def display_name(agent: str) -> str:
    """The name of an agent for people: pilots by their names, a person as `A person`; the other parts unchanged."""
    provenance = Provenance.parse(agent)
    pilot, pilots = provenance.pilot, all_pilots()
    name = "A person" if pilot == HUMAN else pilots[pilot].name if pilot in pilots else pilot
    return str(provenance._replace(pilot=name, of=provenance.of and display_name(provenance.of)))


def can_fly(pilot: str, task: TaskConfig, networks: Networks) -> bool:
    """Whether a pilot can fly a task."""
    if pilot in SOURCES:
        return networks.flies(pilot, task)
    return pilot in OURS or _flies(AGENTS[pilot], task)


@lru_cache
def _flies(make: Callable[[TaskConfig], Agent], task: TaskConfig) -> bool:
    try:
        make(task)
    except (CheckpointError, TooLargeError, UnsupportedTaskError):
        return False
    except Exception:
        log.exception("a registered agent is no pilot on %s: %r cannot be made", task.id, make)
        return False
    return True


def require_pilot(pilot: str, task: TaskConfig, networks: Networks) -> None:
    """Check that a pilot can fly a task, without work on a map.

    Raises:
        UnknownNameError: if there is no such pilot.
        UnsupportedTaskError: if there is no network for the task.
        CheckpointError: if the network file cannot be used.
    """
    if pilot not in all_pilots():
        raise UnknownNameError("pilot", pilot, all_pilots())
    if pilot in SOURCES:
        networks.require(pilot, task)
    elif pilot not in OURS:
        make_agent(pilot, task)


def agent_of(pilot: str, task: TaskConfig, networks: Networks) -> Agent | None:
    """A new agent for a pilot, None for a person.

    Raises:
        UnknownNameError: if there is no such pilot.
        UnsupportedTaskError: if there is no network for the task.
        CheckpointError: if the network file cannot be used.
        TooLargeError: if the maps of the task are too large for the pilot.
        OSError: if the file can no longer be read.
    """
    if pilot not in all_pilots():
        raise UnknownNameError("pilot", pilot, all_pilots())
    if pilot == HUMAN:
        return None
    return networks.agent(pilot, task) if pilot in SOURCES else make_agent(pilot, task)
