"""What a trained network would do, asked about a session or about any observation."""

import threading
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.core.actions import Action
from drone_env.core.observation import write_telemetry
from drone_env.core.rules import BATTERY, CELL, NOWHERE, STEPS, TARGET, interpreted, row_size, view
from drone_env.core.state_manager import Observation
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.models import NAMES, Direction, DroneObservation
from drone_env.server.problems import RequestError
from drone_env.server.schemas import ModelInfo, Prediction


class Networks:
    """The trained networks in a folder, each loaded when it is first asked; safe to share between threads."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._loaded: dict[TaskConfig, PathQNetAgent] = {}
        self._lock = threading.Lock()

    def predict(self, task: TaskConfig, observation: Observation) -> Prediction:
        """The network's values of the actions.

        Raises:
            RequestError: if there is no network for the task.
            CheckpointError: if its file holds none that fits.
        """
        if not self.has(task):
            raise RequestError(
                503,
                "no_network",
                f"there is no network for {task.id!r}: {self._file(task).name} is not in the folder of weights. Train "
                f"one with drone-env train --task {task.short_name}, and copy data/{task.short_name}.npz there under "
                "that name",
            )
        agent = self._agent(task)
        values = agent.q_values(observation)
        return Prediction(
            action=Action(int(np.argmax(values))).name,
            q_values=_by_action(values),
            model=ModelInfo(file=self._file(task).name, digest=str(agent.config["network"])),
        )

    def has(self, task: TaskConfig) -> bool:
        """Whether there is a network for a task."""
        return self._file(task).is_file()

    def q_values(self, task: TaskConfig, observation: Observation) -> dict[Direction, float] | None:
        """The network's value of each action, None where there is no network for the task.

        Raises:
            CheckpointError: if its file holds none that fits.
        """
        return _by_action(self._agent(task).q_values(observation)) if self.has(task) else None

    def pilot(self, task: TaskConfig) -> PathQNetAgent:
        """A new agent that flies by the network of a task.

        Raises:
            OSError: if there is none.
            CheckpointError: if its file holds none that fits.
        """
        return PathQNetAgent(task, self._file(task))

    def _file(self, task: TaskConfig) -> Path:
        return self.folder / f"{task.id}_v{task.version}.npz"

    def _agent(self, task: TaskConfig) -> PathQNetAgent:
        with self._lock:
            agent = self._loaded.get(task)
            if agent is None:
                agent = self._loaded[task] = self.pilot(task)
            return agent


def _by_action(values: npt.NDArray[np.float32]) -> dict[Direction, float]:
    return {Action(i).name: value for i, value in enumerate(values.tolist())}


def arrays_of(observation: DroneObservation) -> tuple[TaskConfig, Observation]:
    """The task that an observation is of, and the observation as agents take it.

    Raises:
        InvalidValueError: if it is of no task of ours, or has more battery than its task.
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
    rules = interpreted(task)
    row = np.zeros(row_size(rules), np.uint16)
    row[CELL] = observation.drone_y * task.width + observation.drone_x
    row[BATTERY] = observation.battery_steps_remaining
    row[STEPS] = observation.step_count
    target = observation.current_target
    row[TARGET] = NOWHERE if target is None else target[1] * task.width + target[0]
    telemetry = np.zeros(task.telemetry_size, np.float32)
    write_telemetry(rules, view(row), view(telemetry))
    grid = np.array([[NAMES.index(name) for name in line] for line in observation.cell_types], np.uint8)
    return task, {"grid": grid, "telemetry": telemetry}
