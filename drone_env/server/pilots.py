"""The pilots of the page: agents, their networks, and people. The provenance of a flight: the pilots of its steps."""

import logging
import re
import threading
import unicodedata
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import lru_cache
from inspect import cleandoc
from pathlib import Path
from types import FunctionType
from typing import NamedTuple

from typing_extensions import Self

from drone_env.agents import AGENTS, NETWORK_AGENTS, SHIPPED_AGENTS, make_agent, tournet
from drone_env.agents.base import Agent
from drone_env.agents.pathqnet import PathQNetAgent, shipped_network
from drone_env.agents.weights_file import TOURNET, network_of
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import CheckpointError, TooLargeError, UnknownNameError, UnsupportedTaskError
from drone_env.files import file_identity

log = logging.getLogger(__name__)
HUMAN, NETWORK, TRAINED = "human", "pathqnet", "trained"
"""The person, and the pilots that fly by a PathQNet: the shipped one, and the one from the data folder."""
WHOLE_MAPS = ("trained-tournet", "tournet", TRAINED, NETWORK)
"""The first of these that supports a task computes the actions for a whole map."""


class Pilot(NamedTuple):
    """A pilot."""

    name: str
    summary: str
    network: str = ""
    """Key of `NETWORK_AGENTS`; empty for a pilot without a network."""
    trained: bool = False
    """Whether the network is in the data folder; shipped networks are not."""


OURS: dict[str, Pilot] = {
    TRAINED: Pilot(
        "Trained here", "The network that you trained, from the data folder of this server.", "pathqnet", trained=True
    ),
    "trained-tournet": Pilot(
        "Tournet trained here", "The tour network that you trained, from the same folder.", "tournet", trained=True
    ),
    NETWORK: Pilot(
        "PathQNet", "The network that is shipped: sees the map, takes the action of the highest value.", "pathqnet"
    ),
    "tournet": Pilot(
        "Tournet", "A network that plans: chooses the parcel or pad to fly to next, and by which way.", "tournet"
    ),
    "greedy": Pilot("Greedy", "Flies to the nearest parcel and looks no further."),
    "optimal": Pilot("Optimal", "Plans a best flight over the whole map and flies it."),
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
# Without spaces and parentheses, a name cannot imitate another part of a provenance.
NAME = r"[\w-]{1,20}"
PROVENANCE = re.compile(
    rf"({HUMAN} \((?P<name>{NAME})\)|(?P<pilot>.+?))( (?P<help>{'|'.join(HELP.values())}))?"
    r"( from step (?P<forked_at>[1-9][0-9]*) of (?P<of>.+))?"
)


class Provenance(NamedTuple):
    """The pilots of a flight, as the `agent` of its session and record: `human with undo from step 20 of pathqnet`.

    The format is a pilot, or `human (NAME)`; then ` with values`, ` with undo` or ` with values and undo` if a person
    used them; then, for a fork, ` from step N of ` and the provenance of the first N steps. Flights of different
    provenance are counted separately.
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
    name: str | None = None
    """The name that a person chose; None without one."""

    @classmethod
    @lru_cache(maxsize=1024)
    def parse(cls, agent: str) -> Self:
        """The provenance that an `agent` contains; any text that has not its format is the name of a pilot."""
        match = PROVENANCE.fullmatch(agent)
        if match is None:
            return cls(agent)
        values, undo = next((used for used, words in HELP.items() if words == match["help"]), (False, False))
        step = None if match["of"] is None else int(match["forked_at"])
        return cls(match["pilot"] or HUMAN, values, undo, step, match["of"], match["name"])

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
        pilot = self.pilot if self.name is None else f"{self.pilot} ({self.name})"
        fork = None if self.of is None else f"from step {self.forked_at} of {self.of}"
        return " ".join(part for part in (pilot, HELP.get((self.values, self.undo)), fork) if part is not None)


def check_name(name: str) -> str:
    """Return the name that a person chose.

    Raises:
        ValueError: if it is not 1 to 20 letters, digits, `_` or `-`, or it is the name of a pilot.
    """
    if not re.fullmatch(NAME, name):
        raise ValueError(f"a person's name has 1 to 20 letters, digits, '_' or '-', got {name[:40]!r}")
    pilots = {known.casefold() for id_, pilot in all_pilots().items() for known in (id_, pilot.name)}
    if unicodedata.normalize("NFKC", name).casefold() in pilots | {"optimum"}:
        raise ValueError(f"{name!r} is the name of a pilot: choose another")
    return name


def display_name(agent: str) -> str:
    """The name of an agent for people: pilots and people by their names, or `A person`; the other parts unchanged."""
    provenance = Provenance.parse(agent)
    pilot, pilots = provenance.pilot, all_pilots()
    name = provenance.name or "A person" if pilot == HUMAN else pilots[pilot].name if pilot in pilots else pilot
    return str(provenance._replace(pilot=name, name=None, of=provenance.of and display_name(provenance.of)))


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


class Networks:
    """The agents of the pilots, with the PathQNets and tour networks of the server, shipped and trained. Thread-safe.

    A trained PathQNet has priority over the shipped one. A file that has changed is read again, so a server uses a new
    network without a restart.

    Args:
        shipped: Folder with `<task id>_v<version>.safetensors` and `tournet_v1.safetensors`.
        trained: Data folder with `<short name>`, `tournet_<short name>` and `tournet`, all `.safetensors`.
    """

    def __init__(self, shipped: Path, trained: Path) -> None:
        self._shipped, self._trained = shipped, trained
        self._loaded: dict[Path, tuple[object, PathQNetAgent | Path | CheckpointError]] = {}
        self._lock = threading.Lock()

    def shown_network(self, pilot: str, task: TaskConfig) -> PathQNetAgent | None:
        """Return the PathQNet whose values the page shows for a flight: the pilot's own, or else the preferred one.

        None if there is none, or its file is invalid.
        """
        shown = pilot if pilot in (TRAINED, NETWORK) else self.preferred(task)
        found = None if shown is None else self._at(shown, task)
        return found if isinstance(found, PathQNetAgent) else None

    def flies(self, pilot: str, task: TaskConfig) -> bool:
        """Return whether a pilot can fly a task."""
        if pilot not in OURS:
            return _flies(AGENTS[pilot], task)
        return not OURS[pilot].network or isinstance(self._at(pilot, task), PathQNetAgent | Path)

    def require(self, pilot: str, task: TaskConfig) -> None:
        """Check that a pilot can fly a task, without work on a map.

        Raises:
            UnknownNameError: if there is no such pilot.
            UnsupportedTaskError: if there is no network for the task.
            CheckpointError: if the network file cannot be used.
        """
        pilots = all_pilots()
        if pilot not in pilots:
            raise UnknownNameError("pilot", pilot, pilots)
        if pilots[pilot].network:
            self.network(pilot, task)
        elif pilot not in OURS:
            make_agent(pilot, task)

    def agent(self, pilot: str, task: TaskConfig) -> Agent | None:
        """Return an agent of a pilot, None for a person. PathQNet agents have no state and are shared; others are new.

        Raises:
            UnsupportedTaskError, CheckpointError: as `require`.
            TooLargeError: if the maps of the task are too large for the pilot.
            OSError: if the file can no longer be read.
        """
        kind = all_pilots()[pilot].network
        if not kind:
            return None if pilot == HUMAN else make_agent(pilot, task)
        found = self.network(pilot, task)
        with _folder_hidden(self.file(pilot, task)):
            return NETWORK_AGENTS[kind](task, found) if isinstance(found, Path) else found

    def network(self, pilot: str, task: TaskConfig) -> PathQNetAgent | Path:
        """Return the network of a pilot for a task: the PathQNet, or the file of a tour network.

        Raises:
            UnsupportedTaskError: if there is none; the message lists the tasks that have one.
            CheckpointError: if its file is invalid; the message contains its name, but not its folder.
        """
        found = self._at(pilot, task)
        if found is None:
            supported = [other.short_name for other in TASKS.values() if self.flies(pilot, other)]
            raise UnsupportedTaskError(
                f"there is no network for {task.id!r}: {pilot!r} has no {self.file(pilot, task).name}; "
                f"it flies {', '.join(supported) or 'nothing here'}"
            )
        if isinstance(found, CheckpointError):
            raise CheckpointError(str(found))
        return found

    def file(self, pilot: str, task: TaskConfig) -> Path:
        """Return the path of a pilot's network for a task, whether it exists or not."""
        trained = OURS[pilot].trained
        folder = self._trained if trained else self._shipped
        if pilot in (TRAINED, NETWORK):
            return folder / (f"{task.short_name}.safetensors" if trained else shipped_network(task).name)
        if not trained:
            return folder / tournet.SHIPPED.name
        # A network of this task has priority over one of all tasks.
        alone = folder / f"tournet_{task.short_name}.safetensors"
        return alone if alone.exists() else folder / "tournet.safetensors"

    def preferred(self, task: TaskConfig) -> str | None:
        """Return the pilot whose PathQNet values the actions of a task; None without a network."""
        return next((pilot for pilot in (TRAINED, NETWORK) if self._at(pilot, task) is not None), None)

    def _at(self, pilot: str, task: TaskConfig) -> PathQNetAgent | Path | CheckpointError | None:
        """Return the network in the current file, or the error if the file is invalid; None without a file.

        Agents of tour networks have state, so for these it is the path.
        """
        file = self.file(pilot, task)
        try:
            now = file_identity(file)
            if now is None:
                return None
            with self._lock:
                loaded = self._loaded.get(file)
                if loaded is None or loaded[0] != now:
                    try:
                        with _folder_hidden(file):
                            network = PathQNetAgent(task, file) if pilot in (TRAINED, NETWORK) else _tour_file(file)
                    except CheckpointError as error:
                        network = error
                    loaded = self._loaded[file] = (now, network)
                return loaded[1]
        except OSError as error:
            return CheckpointError(f"{file.name} cannot be read: {error.strerror}")


@contextmanager
def _folder_hidden(file: Path) -> Generator[None, None, None]:
    """Replace the path of a file by its name in errors: clients must not see where the server's files are."""
    try:
        yield
    except CheckpointError as error:
        raise CheckpointError(str(error).replace(str(file), file.name)) from None


def _tour_file(file: Path) -> Path:
    """Return the file if its header names a tour network. Agents read the rest, which compiles code."""
    network = network_of(file)
    if network != TOURNET:
        raise CheckpointError(f"{file} holds a network of {network!r}, not of {TOURNET!r}")
    return file
