"""The agents of the pilots, with the networks of the server."""

import logging
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

from drone_env.agents import AGENTS, NETWORK_AGENTS, make_agent, tournet
from drone_env.agents.base import Agent
from drone_env.agents.pathqnet import PathQNetAgent, shipped_network
from drone_env.agents.weights_file import TOURNET, network_of
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import CheckpointError, TooLargeError, UnknownNameError, UnsupportedTaskError
from drone_env.files import file_identity
from drone_env.flights.provenance import HUMAN
from drone_env.server.pilots import BUILTIN_PILOTS, NETWORK, TRAINED, all_pilots

log = logging.getLogger(__name__)


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
        if pilot not in BUILTIN_PILOTS:
            return _flies(AGENTS[pilot], task)
        return not BUILTIN_PILOTS[pilot].network or isinstance(self._at(pilot, task), PathQNetAgent | Path)

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
        elif pilot not in BUILTIN_PILOTS:
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
        trained = BUILTIN_PILOTS[pilot].trained
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
