"""What a trained network would do, asked about a session or about any observation."""

import threading
from pathlib import Path

import numpy as np

from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.core.actions import Action
from drone_env.core.observation import write_telemetry
from drone_env.core.rules import BATTERY, CELL, NOWHERE, STEPS, TARGET, interpreted, row_size, view
from drone_env.core.state_manager import Observation
from drone_env.core.tasks import TASKS, TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.models import NAMES, DroneObservation
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
        file = f"{task.id}_v{task.version}.npz"
        with self._lock:
            agent = self._loaded.get(task)
            if agent is None:
                agent = self._loaded[task] = self._load(task, file)
        values = agent.q_values(observation).tolist()
        return Prediction(
            action=Action(int(np.argmax(values))).name,
            q_values={Action(i).name: value for i, value in enumerate(values)},
            model=ModelInfo(file=file, digest=str(agent.config["network"])),
        )

    def _load(self, task: TaskConfig, file: str) -> PathQNetAgent:
        if not (self.folder / file).is_file():
            raise RequestError(
                503,
                "no_network",
                f"there is no network for {task.id!r}: {file} is not in the folder of weights. Train one with "
                f"drone-env train --task {task.short_name}, and copy data/{task.short_name}.npz there under that name",
            )
        return PathQNetAgent(task, self.folder / file)


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
