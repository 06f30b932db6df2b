"""The networks of the server: who flies by them, and what PathQNet would do, asked about any observation."""

import threading
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
from drone_env.server.problems import RequestError
from drone_env.server.schemas import ModelInfo, Prediction, PredictRequest

NETWORK, TRAINED = "pathqnet", "trained"
"""The pilots that fly by a PathQNet: by the one that is shipped, and by the one that was trained here."""


class Source(NamedTuple):
    """Which file a pilot flies by, and how."""

    agent: str
    """Of `NETWORK_AGENTS`."""
    trained: bool
    """Whether it is one that was trained here, not a shipped one."""


SOURCES = {
    TRAINED: Source("pathqnet", trained=True),
    NETWORK: Source("pathqnet", trained=False),
    "trained-tournet": Source("tournet", trained=True),
    "tournet": Source("tournet", trained=False),
    "tournet-search": Source("tournet-search", trained=False),
}
"""The pilots that fly by a network."""
WHOLE_MAPS = ("trained-tournet", "tournet", TRAINED, NETWORK)
"""Who is asked what to do at every cell of a map: the first of them that flies its task."""


class Networks:
    """The networks of the server: of PathQNet one for each task, and the tour network; shipped, and trained here.

    The PathQNet that was trained here goes before: it answers `/predict`, and its values stand on the page. A file that
    is written again, as training does, is read again, so nothing has to be restarted. Safe to share between threads.

    Args:
        shipped: Folder of the shipped networks, `<task id>_v<version>.safetensors` and `tournet_v1.safetensors`.
        trained: The data folder, with `<short name>`, `tournet_<short name>` and `tournet`, all `.safetensors`.
    """

    def __init__(self, shipped: Path, trained: Path) -> None:
        self._shipped, self._trained = shipped, trained
        self._read: dict[Path, tuple[object, PathQNetAgent | Path | CheckpointError]] = {}
        self._lock = threading.Lock()

    def predict(self, task: TaskConfig, observation: Observation) -> Prediction:
        """The values of the actions by the PathQNet that goes before.

        Raises:
            RequestError: if there is no network for the task.
            CheckpointError: if its file holds none that fits.
        """
        source = self._first(task)
        if source is None:
            detail = f"there is no network for {task.id!r}: drone-env train --task {task.short_name} trains one"
            raise RequestError(503, "no_network", detail)
        agent = self.agent(source, task)
        assert isinstance(agent, PathQNetAgent)
        values = agent.q_values(observation)
        return Prediction(
            action=DIRECTIONS[int(np.argmax(values))],
            q_values=dict(zip(DIRECTIONS, values.tolist(), strict=True)),
            model=ModelInfo(file=self.file(source, task).name, digest=str(agent.config["network"])),
        )

    def beside(self, pilot: str, task: TaskConfig) -> PathQNetAgent | None:
        """The PathQNet whose values are shown beside a flight: the pilot's own, for others the one that goes before.

        None where there is none, or its file holds none that fits.
        """
        source = pilot if pilot in (TRAINED, NETWORK) else self._first(task)
        found = None if source is None else self._at(source, task)
        return found if isinstance(found, PathQNetAgent) else None

    def asked(self, task: TaskConfig) -> str | None:
        """Who is asked about whole maps of a task; None if nobody flies it, or can be read."""
        return next((pilot for pilot in WHOLE_MAPS if self.flies(pilot, task)), None)

    def flies(self, source: str, task: TaskConfig) -> bool:
        """Whether there is a network for a task that can be read; `source` is one of `SOURCES`."""
        found = self._at(source, task)
        return found is not None and not isinstance(found, CheckpointError)

    def require(self, source: str, task: TaskConfig) -> PathQNetAgent | Path:
        """What flies a task by a network: PathQNet, or the file of a tour network.

        Raises:
            UnsupportedTaskError: if there is none; the message names the tasks that have one.
            CheckpointError: if its file holds none that fits; the message names it, but not where it lies.
        """
        found, file = self._at(source, task), self.file(source, task)
        if found is None:
            flown = [other.short_name for other in TASKS.values() if self.flies(source, other)]
            raise UnsupportedTaskError(
                f"there is no network for {task.id!r}: {source!r} has no {file.name}; "
                f"it flies {', '.join(flown) or 'nothing here'}"
            )
        if isinstance(found, CheckpointError):
            raise CheckpointError(str(found).replace(str(file), file.name))
        return found

    def agent(self, source: str, task: TaskConfig) -> Agent:
        """What flies by the network of a task. PathQNet keeps nothing of a flight, so all share it; others are new.

        Raises:
            UnsupportedTaskError, CheckpointError: as `require`.
            TooLargeError: if what there is to see on a map of the task would take too much memory.
            OSError: if the file can no longer be read.
        """
        found, file = self.require(source, task), self.file(source, task)
        try:
            return NETWORK_AGENTS[SOURCES[source].agent].make(task, found) if isinstance(found, Path) else found
        except CheckpointError as error:
            raise CheckpointError(str(error).replace(str(file), file.name)) from None

    def described(self) -> list[str]:
        """Lines for the start of the server: which network files are flown by, and which are refused."""
        lines: dict[Path, str] = {}
        for source in SOURCES:
            for task in TASKS.values():
                file, found = self.file(source, task), self._at(source, task)
                if found is not None:
                    told = f"refused: {found}" if isinstance(found, CheckpointError) else f"{source!r} flies by {file}"
                    lines.setdefault(file, told)
        return list(lines.values())

    def _first(self, task: TaskConfig) -> str | None:
        return next((source for source in (TRAINED, NETWORK) if self._at(source, task) is not None), None)

    def file(self, source: str, task: TaskConfig) -> Path:
        """The file of a pilot's network for a task, there or not."""
        agent, trained = SOURCES[source]
        if agent == "pathqnet":
            return (
                self._trained / f"{task.short_name}.safetensors"
                if trained
                else self._shipped / shipped_network(task).name
            )
        if not trained:
            return self._shipped / tournet.SHIPPED.name
        # The one that has learned this task alone goes before the one that has learned all.
        alone = self._trained / f"tournet_{task.short_name}.safetensors"
        return alone if alone.exists() else self._trained / "tournet.safetensors"

    def _at(self, source: str, task: TaskConfig) -> PathQNetAgent | Path | CheckpointError | None:
        """What flies by a file as it is now: PathQNet, or the file of a tour network, whose agents are not shared.

        If the file is wrong, what is; None where there is none.
        """
        file = self.file(source, task)
        try:
            now = stamp(file)
            if now is None:
                return None
            with self._lock:
                read = self._read.get(file)
                if read is None or read[0] != now:
                    try:
                        found = PathQNetAgent(task, file) if source in (TRAINED, NETWORK) else tour_file(file)
                    except CheckpointError as error:
                        found = error
                    read = self._read[file] = (now, found)
                return read[1]
        except OSError as error:
            return CheckpointError(f"{file} cannot be read: {error}")


def tour_file(file: Path) -> Path:
    """A file that says of itself that it holds a tour network. All of it is read by what flies by it, which compiles.

    Raises:
        CheckpointError: if it does not.
        OSError: if it cannot be read.
    """
    found = network_of(file)
    if found != TOURNET:
        raise CheckpointError(f"{file} holds a network of {found!r}, not of {TOURNET!r}")
    return file


def arrays_of(observation: DroneObservation | PredictRequest) -> tuple[TaskConfig, Observation]:
    """The task that an observation is of, and the observation as agents take it.

    Raises:
        InvalidValueError: if it is of no task of ours, has more battery than its task, or lacks the cell below
            the drone in a task with pads.
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
            f"{', '.join(possible)} lies below the drone; /reset and /step answer it"
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
