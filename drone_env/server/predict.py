"""The networks of the server: which pilots use them, and `/predict`."""

import threading
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from drone_env.agents import NETWORK_AGENTS, tournet
from drone_env.agents.base import Agent
from drone_env.agents.pathqnet import PathQNetAgent, shipped_network
from drone_env.agents.weights_file import TOURNET, network_of
from drone_env.core.cells import Cell
from drone_env.core.episode import Observation
from drone_env.core.observation import telemetry_of
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import CheckpointError, InvalidValueError, UnsupportedTaskError
from drone_env.files import stamp
from drone_env.models import DIRECTIONS, NAMES, DroneObservation
from drone_env.server.exceptions import RequestError
from drone_env.server.schemas import ModelInfo, Prediction, PredictRequest

NETWORK, TRAINED = "pathqnet", "trained"
"""The pilots that fly by a PathQNet: the shipped one, and the one from the data folder."""


class Source(NamedTuple):
    """The network of a pilot."""

    agent: str
    """Key of `NETWORK_AGENTS`."""
    trained: bool
    """Whether the network is in the data folder; shipped networks are not."""


SOURCES = {
    TRAINED: Source("pathqnet", trained=True),
    NETWORK: Source("pathqnet", trained=False),
    "trained-tournet": Source("tournet", trained=True),
    "tournet": Source("tournet", trained=False),
    "tournet-search": Source("tournet-search", trained=False),
}
"""The pilots that fly by a network."""
WHOLE_MAPS = ("trained-tournet", "tournet", TRAINED, NETWORK)
"""The first of these that supports a task computes the actions for a whole map."""


class Networks:
    """The PathQNets and tour networks of the server, shipped and trained. Thread-safe.

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

    def predict(self, task: TaskConfig, observation: Observation) -> Prediction:
        """Compute the action values of a task's PathQNet.

        Raises:
            RequestError: if there is no network for the task.
            CheckpointError: if its file is invalid.
        """
        source = self._first(task)
        if source is None:
            detail = f"there is no network for {task.id!r}; train one: drone-env train --task {task.short_name}"
            raise RequestError(503, "no_network", detail)
        agent = self.require(source, task)
        assert isinstance(agent, PathQNetAgent)
        values = agent.q_values(observation)
        return Prediction(
            action=DIRECTIONS[int(np.argmax(values))],
            q_values=dict(zip(DIRECTIONS, values.tolist(), strict=True)),
            model=ModelInfo(file=self.file(source, task).name, digest=str(agent.config["network"])),
        )

    def shown_network(self, pilot: str, task: TaskConfig) -> PathQNetAgent | None:
        """Return the PathQNet whose values the page shows for a flight: the pilot's own, or else the preferred one.

        None if there is none, or its file is invalid.
        """
        source = pilot if pilot in (TRAINED, NETWORK) else self._first(task)
        found = None if source is None else self._at(source, task)
        return found if isinstance(found, PathQNetAgent) else None

    def map_network(self, task: TaskConfig) -> str | None:
        """Return the pilot that computes the actions for a whole map, or None."""
        return next((pilot for pilot in WHOLE_MAPS if self.flies(pilot, task)), None)

    def flies(self, source: str, task: TaskConfig) -> bool:
        """Return whether a pilot of `SOURCES` has a valid network for a task."""
        found = self._at(source, task)
        return found is not None and not isinstance(found, CheckpointError)

    def require(self, source: str, task: TaskConfig) -> PathQNetAgent | Path:
        """Return the network of a pilot for a task: the PathQNet, or the file of a tour network.

        Raises:
            UnsupportedTaskError: if there is none; the message lists the tasks that have one.
            CheckpointError: if its file is invalid; the message contains its name, but not its folder.
        """
        found = self._at(source, task)
        if found is None:
            supported = [other.short_name for other in TASKS.values() if self.flies(source, other)]
            raise UnsupportedTaskError(
                f"there is no network for {task.id!r}: {source!r} has no {self.file(source, task).name}; "
                f"it flies {', '.join(supported) or 'nothing here'}"
            )
        if isinstance(found, CheckpointError):
            raise CheckpointError(str(found))
        return found

    def agent(self, source: str, task: TaskConfig) -> Agent:
        """Return an agent for a task. PathQNet agents have no state and are shared; others are new.

        Raises:
            UnsupportedTaskError, CheckpointError: as `require`.
            TooLargeError: if the features of a map would take too much memory.
            OSError: if the file cannot be read.
        """
        found = self.require(source, task)
        with _folder_hidden(self.file(source, task)):
            return NETWORK_AGENTS[SOURCES[source].agent].make(task, found) if isinstance(found, Path) else found

    def file(self, source: str, task: TaskConfig) -> Path:
        """Return the path of a pilot's network for a task, whether it exists or not."""
        agent, trained = SOURCES[source]
        folder = self._trained if trained else self._shipped
        if agent == "pathqnet":
            return folder / (f"{task.short_name}.safetensors" if trained else shipped_network(task).name)
        if not trained:
            return folder / tournet.SHIPPED.name
        # A network of this task has priority over one of all tasks.
        alone = folder / f"tournet_{task.short_name}.safetensors"
        return alone if alone.exists() else folder / "tournet.safetensors"

    def _first(self, task: TaskConfig) -> str | None:
        return next((source for source in (TRAINED, NETWORK) if self._at(source, task) is not None), None)

    def _at(self, source: str, task: TaskConfig) -> PathQNetAgent | Path | CheckpointError | None:
        """Return the network in the current file, or the error if the file is invalid; None without a file.

        Agents of tour networks have state, so for these it is the path.
        """
        file = self.file(source, task)
        try:
            now = stamp(file)
            if now is None:
                return None
            with self._lock:
                loaded = self._loaded.get(file)
                if loaded is None or loaded[0] != now:
                    try:
                        with _folder_hidden(file):
                            network = PathQNetAgent(task, file) if source in (TRAINED, NETWORK) else _tour_file(file)
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


def arrays_of(observation: DroneObservation | PredictRequest) -> tuple[TaskConfig, Observation]:
    """Return the task and the arrays of an observation, as agents need them.

    Raises:
        InvalidValueError: if no task matches, the battery exceeds the task's capacity, or `cell_below` is missing in a
            task with pads.
    """
    shape = (observation.grid_width, observation.grid_height, observation.deliveries_total, observation.max_steps)
    shapes = {(task.width, task.height, task.deliveries, task.max_steps): task for task in TASKS.values()}
    task = shapes.get(shape)
    if task is None:
        known = "; ".join(f"{task.id} {shape}" for shape, task in shapes.items())
        raise InvalidValueError(
            f"no task has (grid_width, grid_height, deliveries_total, max_steps) = {shape}; there are: {known}"
        )
    if observation.battery_steps_remaining > task.battery_capacity:
        raise InvalidValueError(f"battery_steps_remaining must be at most {task.battery_capacity} in {task.id!r}")
    below = observation.cell_below
    placed = [kind for kind, count in task.cell_counts().items() if count and kind not in task.impassable]
    possible = [NAMES[kind] for kind in (Cell.ROAD, Cell.DELIVERED, *placed)]
    if below not in possible and (below is not None or task.pads):
        raise InvalidValueError(
            f"cell_below {'is missing' if below is None else f'cannot be {below}'}: in {task.id!r} one of "
            f"{', '.join(possible)} is below the drone; /reset and /step return it"
        )
    target = observation.current_target
    telemetry = telemetry_of(
        task,
        cell=observation.drone_y * task.width + observation.drone_x,
        under=0 if below is None else NAMES.index(below),
        battery=observation.battery_steps_remaining,
        steps=observation.step_count,
        target=None if target is None else target[1] * task.width + target[0],
    )
    grid = np.array([[NAMES.index(name) for name in line] for line in observation.cell_types], np.uint8)
    return task, {"grid": grid, "telemetry": telemetry}
