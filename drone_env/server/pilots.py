"""Who can fly on the page: the agents, and the person at the page; and how it is said who flew."""

import logging
import re
from collections.abc import Callable, Iterator, Mapping
from functools import lru_cache
from inspect import cleandoc
from types import FunctionType
from typing import NamedTuple

from typing_extensions import Self

from drone_env.agents import AGENTS, SHIPPED_AGENTS, make_agent
from drone_env.agents.base import Agent
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import CheckpointError, TooLargeError, UnknownNameError, UnsupportedTaskError
from drone_env.server.predict import NETWORK, SOURCES, TRAINED, Networks

log = logging.getLogger(__name__)
HUMAN = "human"


class Pilot(NamedTuple):
    """One who flies."""

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
"""On the page, `--pilot-1` and so on: more agents than that share the last."""


class _Pilots(Mapping[str, Pilot]):
    """Ours, and the agents that were registered, as plugins do before the server starts."""

    def _all(self) -> dict[str, Pilot]:
        registered = {name: make for name, make in AGENTS.items() if name not in (*SHIPPED_AGENTS, *OURS)}
        return OURS | {name: Pilot(name, _summary(make)) for name, make in registered.items()}

    def __getitem__(self, name: str) -> Pilot:
        return self._all()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())


def _summary(make: object) -> str:
    own = make.__doc__ if isinstance(make, type | FunctionType) else None  # others have that of their type
    told = own or "An agent that a plugin of this server registered."
    return cleandoc(told).partition("\n\n")[0].replace("\n", " ")


PILOTS: Mapping[str, Pilot] = _Pilots()

HELP = {(True, False): "with values", (False, True): "with undo", (True, True): "with values and undo"}
CREDIT = re.compile(
    f"(?P<pilot>.+?)( (?P<help>{'|'.join(HELP.values())}))?( from step (?P<forked_at>[1-9][0-9]*) of (?P<of>.+))?"
)


class Credit(NamedTuple):
    """Who flew, as sessions and records say it in their `agent`: `human with undo from step 20 of pathqnet`.

    That is a pilot; then, where there was any, ` with values`, ` with undo` or ` with values and undo`; then, where the
    steps before were another's, ` from step N of ` and who flew those, said in the same way. Flights that differ in it
    are counted apart.
    """

    pilot: str
    """One of `PILOTS`, or whatever else a record names."""
    values: bool = False
    """Whether a person has asked, in flight, for what each action is worth."""
    undo: bool = False
    """Whether a person has taken back steps."""
    forked_at: int | None = None
    """The steps that others flew, 1 or more; None where there are none."""
    of: str | None = None
    """Who flew them; None likewise."""

    @classmethod
    def parse(cls, agent: str) -> Self:
        """What an `agent` says; one that is no pilot's is a name as a whole, as far as it says none of the above."""
        said = CREDIT.fullmatch(agent)
        if said is None:
            return cls(agent)
        values, undo = next((given for given, words in HELP.items() if words == said["help"]), (False, False))
        step = None if said["of"] is None else int(said["forked_at"])
        return cls(said["pilot"], values, undo, step, said["of"])

    @classmethod
    def of_fork(cls, pilot: str, step: int, of: str) -> Self:
        """Who flies where a pilot goes on from a step of a flight.

        Args:
            pilot: Who flies on.
            step: How many steps of that flight there are.
            of: Who flew it. On a flight of its own a pilot goes on as if there were no fork; a person has then taken
                back steps. From step 0 nothing is another's: a person's own flight is begun again as it was left.
        """
        before = cls.parse(of)
        while before.forked_at is not None and before.of is not None and step <= before.forked_at:
            before = cls.parse(before.of)
        if step == 0:
            return before if before.pilot == pilot else cls(pilot)
        if before.pilot == pilot:
            return before._replace(undo=before.undo or pilot == HUMAN)
        return cls(pilot, forked_at=step, of=str(before))

    @property
    def additions(self) -> list[str]:
        """What is said of who flew beside the pilot."""
        fork = None if self.of is None else f"from step {self.forked_at} of {self.of}"
        return [said for said in (HELP.get((self.values, self.undo)), fork) if said]

    def __str__(self) -> str:
        return " ".join([self.pilot, *self.additions])


def called(agent: str) -> str:
    """What people call who has flown: a pilot, a person, or whatever a record names; with help, and from which step."""
    credit = Credit.parse(agent)
    name = "A person" if credit.pilot == HUMAN else getattr(PILOTS.get(credit.pilot), "name", credit.pilot)
    return str(credit._replace(pilot=name, of=credit.of and called(credit.of)))


def tasks_of(pilot: str, networks: Networks) -> list[str]:
    """Ids of the tasks that a pilot can fly."""
    return [task.id for task in TASKS.values() if can_fly(pilot, task, networks)]


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
    """See that a pilot flies a task, as far as that shows without working on a map.

    Raises:
        UnknownNameError: if there is no such pilot.
        UnsupportedTaskError: if there is no network for the task.
        CheckpointError: if its file holds none that fits.
    """
    if pilot not in PILOTS:
        raise UnknownNameError("pilot", pilot, PILOTS)
    if pilot in SOURCES:
        networks.require(pilot, task)
    elif pilot not in OURS:
        make_agent(pilot, task)


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
