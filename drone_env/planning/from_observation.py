"""An episode rebuilt from what an agent observes, so that planners can be asked about it."""

import numpy as np

from drone_env.core.actions import Event, Outcome
from drone_env.core.cells import Cell
from drone_env.core.dynamics import choose_target
from drone_env.core.rewards import get_reward_profile
from drone_env.core.rules import (
    BATTERY,
    CELL,
    DELIVERED_FLAG,
    DELIVERIES,
    EVENT,
    OUTCOME,
    PARCELS,
    STEPS,
    UNDER,
    interpreted,
    row_size,
    view,
)
from drone_env.core.state_manager import Episode, EpisodeState, Observation
from drone_env.core.tasks import TaskConfig
from drone_env.planning.greedy import drone_position


def episode_of(task: TaskConfig, observation: Observation, under: int = Cell.ROAD) -> Episode:
    """An episode in flight that shows this observation. Parcels are numbered in reading order, its seed is 0.

    Args:
        task: The task.
        observation: What is seen.
        under: The kind of the cell below the drone, which the grid hides; ROAD at the start of every episode. Where a
            parcel is missing on the grid, the drone has just delivered it there, whatever is said here.
    """
    rules = interpreted(task)
    grid = np.ravel(observation["grid"]).copy()
    telemetry = observation["telemetry"].tolist()
    x, y = drone_position(task, observation)
    row = np.zeros(row_size(rules), np.uint16)
    row[CELL] = y * task.width + x
    row[BATTERY] = round(telemetry[2] * task.battery_capacity)
    left = round(telemetry[5] * task.max_steps) if len(telemetry) > 5 else int(row[BATTERY])
    row[STEPS] = task.max_steps - left
    row[EVENT] = Event.NONE
    row[OUTCOME] = Outcome.FLYING
    parcels = np.isin(grid, (Cell.DELIVERY, Cell.DELIVERED)).sum()
    if parcels < task.deliveries:
        under = Cell.DELIVERED
    row[UNDER] = under
    grid[row[CELL]] = under
    waiting, delivered = (np.flatnonzero(grid == kind) for kind in (Cell.DELIVERY, Cell.DELIVERED))
    row[PARCELS:] = np.concatenate([waiting, delivered + DELIVERED_FLAG])
    row[DELIVERIES] = len(delivered)
    grid[row[CELL]] = Cell.DRONE
    choose_target(rules, view(row))
    profile = get_reward_profile("score")
    episode = Episode(task, profile)
    episode.set_state(EpisodeState(task, profile, 0, grid.tobytes(), row.tobytes(), 0.0, 0.0, ()))
    return episode
