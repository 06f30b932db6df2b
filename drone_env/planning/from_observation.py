"""An episode rebuilt from what an agent observes, so that planners can be asked about it."""

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Event
from drone_env.core.cells import N_CELL_KINDS, Cell
from drone_env.core.episode import Episode, EpisodeState, Observation
from drone_env.core.rewards import get_reward_profile
from drone_env.core.rules import choose_target, outcome
from drone_env.core.tables import (
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
    state_size,
    view,
)
from drone_env.core.tasks import TERRAIN, TaskConfig
from drone_env.planning.greedy import drone_position


def episode_of(task: TaskConfig, observation: Observation, reward_profile: str = "score") -> Episode:
    """An episode that shows this observation. Parcels are numbered in reading order, its seed is 0."""
    tables = interpreted(task)
    grid = np.ravel(observation["grid"]).copy()
    telemetry = observation["telemetry"].tolist()
    x, y = drone_position(task, observation)
    state = np.zeros(state_size(tables), np.uint16)
    state[CELL] = y * task.width + x
    state[BATTERY] = round(telemetry[2] * task.battery_capacity)
    left = round(telemetry[5] * task.max_steps) if len(telemetry) > 5 else int(state[BATTERY])
    state[STEPS] = task.max_steps - left
    state[EVENT] = Event.NONE
    state[UNDER] = TERRAIN[telemetry[6:].index(1)] if len(telemetry) > 6 else hidden_kind(task, grid)
    grid[state[CELL]] = state[UNDER]
    waiting, delivered = (np.flatnonzero(grid == kind) for kind in (Cell.DELIVERY, Cell.DELIVERED))
    state[PARCELS:] = np.concatenate([waiting, delivered + DELIVERED_FLAG])
    state[DELIVERIES] = len(delivered)
    state[OUTCOME] = outcome(tables, view(state))
    grid[state[CELL]] = Cell.DRONE
    choose_target(tables, view(state))
    profile = get_reward_profile(reward_profile)
    episode = Episode(task, profile)
    episode.set_state(EpisodeState(task, profile, 0, grid.tobytes(), state.tobytes(), 0.0, 0.0, ()))
    return episode


def hidden_kind(task: TaskConfig, grid: npt.NDArray[np.uint8]) -> int:
    """The kind of the cell below the drone where no telemetry tells it: the one of which the grid shows too few."""
    shown = np.bincount(grid, minlength=N_CELL_KINDS)
    if shown[Cell.DELIVERY] + shown[Cell.DELIVERED] < task.deliveries:
        return Cell.DELIVERED
    missing = [kind for kind, count in task.cell_counts().items() if shown[kind] < count]
    return missing[0] if missing else Cell.ROAD
