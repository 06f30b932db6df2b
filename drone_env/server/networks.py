"""The agents of the pilots, with the networks of the server."""

import logging
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from drone_env.agents import AGENTS, NETWORK_AGENTS, make_agent, tournet
from drone_env.agents.base import Agent
from drone_env.agents.pathqnet import PathQNetAgent, shipped_network
from drone_env.agents.weights_file import PPO, network_of
from drone_env.core.tasks import TaskConfig
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
    """The agents of the pilots, with the networks of the server, shipped and trained. Thread-safe.

    A trained PathQNet has priority over the shipped one. A file that has changed is read again, so a server uses a new
    network without a restart.

    Args:
        shipped: Folder with `<task id>_v<version>.safetensors`, `ppo_<task id>_v<version>.safetensors` and
            `tournet_v1.safetensors`.
        trained: Data folder with `<short name>`, `ppo_<short name>`, `tournet_<short name>` and `tournet`, all
            `.safetensors`.
    """

    def __init__(self, shipped: Path, trained: Path) -> None:
        self._shipped, self._trained = shipped, trained
        self._loaded: dict[Path, tuple[object, PathQNetAgent | Path]] = {}
        self._lock = threading.Lock()

    def shown_network(self, pilot: str, task: TaskConfig) -> PathQNetAgent | None:
        """Return the PathQNet whose values the page shows for a flight: the pilot's own, or else the preferred one.

        None if there is none, or its file is invalid.
        """
        shown = pilot if pilot in (TRAINED, NETWORK) else self.preferred(task)
        with suppress(CheckpointError, UnsupportedTaskError):
            network = None if shown is None else self.network(shown, task)
            return network if isinstance(network, PathQNetAgent) else None
        return None

    def flies(self, pilot: str, task: TaskConfig) -> bool:
        """Return whether a pilot can fly a task."""
        if pilot not in BUILTIN_PILOTS:
            return _flies(AGENTS[pilot], task)
        try:
            self.require(pilot, task)
        except (CheckpointError, UnsupportedTaskError):
            return False
        return True

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
        return NETWORK_AGENTS[kind](task, found) if isinstance(found, Path) else found

    def network(self, pilot: str, task: TaskConfig) -> PathQNetAgent | Path:
        """Return the network of a pilot for a task: the PathQNet, or the file of another network, whose agents are new.

        Raises:
            UnsupportedTaskError: if there is none.
            CheckpointError: if its file is invalid.
        """
        file = self.file(pilot, task)
        with self._lock:
            try:
                identity = file_identity(file)
                if identity is None:
                    raise UnsupportedTaskError(f"there is no network for {task.id!r}: {pilot!r} has no {file.name}")
                if file not in self._loaded or self._loaded[file][0] != identity:
                    network = PathQNetAgent(task, file) if pilot in (TRAINED, NETWORK) else _checked(file, pilot)
                    self._loaded[file] = identity, network
            except OSError as error:
                raise CheckpointError(f"{file.name} cannot be read: {error.strerror}") from None
            return self._loaded[file][1]

    def file(self, pilot: str, task: TaskConfig) -> Path:
        """Return the path of a pilot's network for a task, whether it exists or not."""
        _, _, network, trained = BUILTIN_PILOTS[pilot]
        folder = self._trained if trained else self._shipped
        if pilot in (TRAINED, NETWORK):
            return folder / (f"{task.short_name}.safetensors" if trained else shipped_network(task).name)
        if network == PPO:
            return folder / (f"ppo_{task.short_name}.safetensors" if trained else shipped_network(task, PPO).name)
        if not trained:
            return folder / tournet.SHIPPED.name
        # A network of this task has priority over one of all tasks.
        alone = folder / f"tournet_{task.short_name}.safetensors"
        return alone if alone.exists() else folder / "tournet.safetensors"

    def preferred(self, task: TaskConfig) -> str | None:
        """Return the pilot whose PathQNet values the actions of a task; None without a network."""
        return next((pilot for pilot in (TRAINED, NETWORK) if self.file(pilot, task).exists()), None)


def _checked(file: Path, pilot: str) -> Path:
    """Return the file if its header names the pilot's network. Agents read the rest, which compiles code."""
    network, flown = network_of(file), BUILTIN_PILOTS[pilot].network
    if network != flown:
        raise CheckpointError(f"{file} holds a network of {network!r}, not of {flown!r}")
    return file
