"""An episode put together from its fields, without the steps that led there."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Event
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode, EpisodeState
from drone_env.core.rewards import RewardProfile, get_reward_profile
from drone_env.core.rules import choose_target, outcome
from drone_env.core.tables import (
    BATTERY,
    CELL,
    DELIVERED_FLAG,
    DELIVERIES_DONE,
    EVENT,
    OUTCOME,
    PARCELS,
    STEPS,
    UNDER,
    interpreted,
    state_size,
    view,
)
from drone_env.core.tasks import TaskConfig


def standing_episode(
    task: TaskConfig,
    ground: npt.NDArray[np.uint8],
    drone: int,
    battery: int,
    steps: int,
    parcels: Sequence[tuple[int, bool]],
    reward_profile: str | RewardProfile = "score",
) -> Episode:
    """An episode that stands so, as far as it is known: its seed is 0, and it has flown nothing.

    Args:
        task: The task.
        ground: uint8[height, width] or uint8[cells], the grid without the drone.
        drone: The cell that the drone is in, y * width + x.
        battery: Units left.
        steps: Steps taken.
        parcels: The cell of each parcel, and whether it has been delivered.
        reward_profile: A reward profile or its name.

    Raises:
        UnknownNameError: if there is no such profile.
    """
    tables, grid = interpreted(task), ground.ravel().copy()
    state = np.zeros(state_size(tables), np.uint16)
    state[[CELL, UNDER, BATTERY, STEPS, EVENT]] = drone, grid[drone], battery, steps, Event.NONE
    state[PARCELS:] = [cell + delivered * DELIVERED_FLAG for cell, delivered in parcels]
    state[DELIVERIES_DONE] = sum(delivered for _, delivered in parcels)
    state[OUTCOME] = outcome(tables, view(state))
    choose_target(tables, view(state))
    grid[drone] = Cell.DRONE
    profile = get_reward_profile(reward_profile)
    episode = Episode(task, profile)
    episode.set_state(EpisodeState(task, profile, 0, grid.tobytes(), state.tobytes(), 0.0, ()))
    return episode
