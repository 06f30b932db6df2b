"""An episode rebuilt from what an agent observes, so that planners can be asked about it."""

import numpy as np
import numpy.typing as npt

from drone_env.core.cells import N_CELL_KINDS, Cell
from drone_env.core.episode import Episode, Observation
from drone_env.core.standing import standing_episode
from drone_env.core.tasks import TERRAIN, TaskConfig
from drone_env.planning.greedy import drone_positions


def episode_of(task: TaskConfig, observation: Observation, reward_profile: str = "score") -> Episode:
    """An episode that shows this observation. Parcels are numbered in reading order, its seed is 0."""
    ground = np.ravel(observation["grid"]).copy()
    telemetry = observation["telemetry"].tolist()
    x, y = drone_positions(task, observation["telemetry"][None])[0].tolist()
    drone = y * task.width + x
    battery = round(telemetry[2] * task.battery_capacity)
    left = round(telemetry[5] * task.max_steps) if len(telemetry) > 5 else battery
    ground[drone] = TERRAIN[telemetry[6:].index(1)] if len(telemetry) > 6 else hidden_kind(task, ground)
    kinds = (Cell.DELIVERY, False), (Cell.DELIVERED, True)
    parcels = [(cell, delivered) for kind, delivered in kinds for cell in np.flatnonzero(ground == kind).tolist()]
    return standing_episode(task, ground, drone, battery, task.max_steps - left, parcels, reward_profile)


def hidden_kind(task: TaskConfig, grid: npt.NDArray[np.uint8]) -> int:
    """The kind of the cell below the drone where no telemetry names it: the one of which the grid shows too few."""
    shown = np.bincount(grid, minlength=N_CELL_KINDS)
    if shown[Cell.DELIVERY] + shown[Cell.DELIVERED] < task.deliveries:
        return Cell.DELIVERED
    missing = [kind for kind, count in task.cell_counts().items() if shown[kind] < count]
    return missing[0] if missing else Cell.ROAD
