"""What a trained network would do, asked about a session or about any observation."""

import threading
from pathlib import Path

import numpy as np

from drone_env.agents.pathqnet import PathQNetAgent, shipped_network
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
"""The pilots that fly by a network: by the one that is shipped, and by the one that was trained here."""


class Networks:
    """The networks of the server: for each task the one that is shipped, and the one that was trained here.

    The trained one goes before: it answers `/predict`, and tells what the network thinks on the page. A file that is
    written again, as training does, is read again, so nothing has to be restarted. Safe to share between threads.

    Args:
        shipped: Folder of the networks that are shipped, `<task id>_v<version>.npz`.
        trained: The data folder, `<short name>.npz`.
    """

    def __init__(self, shipped: Path, trained: Path) -> None:
        self._folders = {NETWORK: shipped, TRAINED: trained}
        self._read: dict[Path, tuple[object, PathQNetAgent | CheckpointError]] = {}
        self._lock = threading.Lock()

    def predict(self, task: TaskConfig, observation: Observation) -> Prediction:
        """The values of the actions by the network that goes before.

        Raises:
            RequestError: if there is no network for the task.
            CheckpointError: if its file holds none that fits.
        """
        source = self._first(task)
        if source is None:
            raise RequestError(
                503,
                "no_network",
                f"there is no network for {task.id!r}: neither {self._file(TRAINED, task).name} in the data folder nor "
                f"{self._file(NETWORK, task).name} in the folder of weights. drone-env train --task {task.short_name} "
                "trains one; the data folder of the server is where it should leave it (--data)",
            )
        agent = self.agent(source, task)
        values = agent.q_values(observation)
        return Prediction(
            action=DIRECTIONS[int(np.argmax(values))],
            q_values=dict(zip(DIRECTIONS, values.tolist(), strict=True)),
            model=ModelInfo(file=self._file(source, task).name, digest=str(agent.config["network"])),
        )

    def beside(self, pilot: str, task: TaskConfig) -> PathQNetAgent | None:
        """The network whose values are shown beside a flight: the pilot's own, for others the one that goes before.

        None where there is none, or its file holds none that fits.
        """
        source = pilot if pilot in self._folders else self._first(task)
        found = None if source is None else self._at(source, task)
        return found if isinstance(found, PathQNetAgent) else None

    def flies(self, source: str, task: TaskConfig) -> bool:
        """Whether there is a network for a task that can be read; `source` is `NETWORK` or `TRAINED`."""
        return isinstance(self._at(source, task), PathQNetAgent)

    def agent(self, source: str, task: TaskConfig) -> PathQNetAgent:
        """What flies by the network of a task. It keeps nothing of a flight, so all may share it.

        Raises:
            UnsupportedTaskError: if there is none.
            CheckpointError: if its file holds none that fits; the message names it.
        """
        found = self._at(source, task)
        if found is None:
            raise UnsupportedTaskError(f"there is no network for {task.id!r}: {self._file(source, task)} is not there")
        if isinstance(found, CheckpointError):
            raise CheckpointError(str(found))
        return found

    def described(self) -> list[str]:
        """Lines for the start of the server: which network flies which task, which files are refused."""
        lines: list[str] = []
        for task in TASKS.values():
            parts: list[str] = []
            for source, what in ((TRAINED, "trained here"), (NETWORK, "shipped")):
                found = self._at(source, task)
                if isinstance(found, CheckpointError):
                    parts.append(f"refused, and so is /predict: {found}")
                elif found is not None:
                    parts.append(f"{source!r} flies by {self._file(source, task)} ({what})")
            if parts:
                lines.append(f"{task.short_name}: {'; '.join(parts)}")
        return lines

    def _first(self, task: TaskConfig) -> str | None:
        return next((source for source in (TRAINED, NETWORK) if self._at(source, task) is not None), None)

    def _file(self, source: str, task: TaskConfig) -> Path:
        name = f"{task.short_name}.npz" if source == TRAINED else shipped_network(task).name
        return self._folders[source] / name

    def _at(self, source: str, task: TaskConfig) -> PathQNetAgent | CheckpointError | None:
        """What flies by a file as it is now; what is wrong with it; None where there is none."""
        file = self._file(source, task)
        try:
            now = stamp(file)
            if now is None:
                return None
            with self._lock:
                read = self._read.get(file)
                if read is None or read[0] != now:
                    try:
                        found = PathQNetAgent(task, file)
                    except CheckpointError as error:
                        found = error
                    read = self._read[file] = (now, found)
                return read[1]
        except OSError as error:
            return CheckpointError(f"{file} cannot be read: {error}")


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
