"""Episodes from their fields or from an observation, as inputs of planners."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Event
from drone_env.core.cells import N_CELL_KINDS, Cell
from drone_env.core.episode import Episode, EpisodeState, Observation
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
from drone_env.core.tasks import TERRAIN, TaskConfig
from drone_env.errors import InvalidValueError


def episode_from_fields(
    task: TaskConfig,
    ground: npt.NDArray[np.uint8],
    drone: int,
    battery: int,
    steps: int,
    parcels: Sequence[tuple[int, bool]],
    reward_profile: str | RewardProfile = "score",
) -> Episode:
    """Create an episode with these fields. Its seed is 0, its path is empty.

    Args:
        task: The task.
        ground: uint8[height, width] or uint8[cells], the grid without the drone.
        drone: Cell of the drone, y * width + x.
        battery: Units left.
        steps: Steps taken.
        parcels: Cell of each parcel, and whether it has been delivered.
        reward_profile: A reward profile or its name.
    """
    tables, grid = interpreted(task), ground.ravel().copy()
    state = np.zeros(state_size(tables), np.uint16)
    state[[CELL, UNDER, BATTERY, STEPS, EVENT]] = drone, grid[drone], battery, steps, Event.NONE
    state[PARCELS:] = [cell + delivered * DELIVERED_FLAG for cell, delivered in parcels]
    state[DELIVERIES_DONE] = sum(delivered for _, delivered in parcels)
    state[OUTCOME] = outcome(tables, int(state[DELIVERIES_DONE]), battery, steps)
    choose_target(tables, view(state))
    grid[drone] = Cell.DRONE
    profile = get_reward_profile(reward_profile)
    episode = Episode(task, profile)
    episode.set_state(EpisodeState(task, profile, 0, grid.tobytes(), state.tobytes(), 0.0, ()))
    return episode


def episode_of(task: TaskConfig, observation: Observation, reward_profile: str = "score") -> Episode:
    """Create an episode with this observation. Its seed is 0, its parcels are in reading order.

    Raises:
        InvalidValueError: if this is not an observation of the task.
    """
    (ground,), ((drone, battery, left),) = read_observations(
        task, observation["grid"][None], observation["telemetry"][None]
    )
    kinds = (Cell.DELIVERY, False), (Cell.DELIVERED, True)
    parcels = [(cell, delivered) for kind, delivered in kinds for cell in np.flatnonzero(ground == kind).tolist()]
    if len(parcels) != task.deliveries:
        raise InvalidValueError(f"an observation shows {len(parcels)} parcels; {task.id!r} has {task.deliveries}")
    steps = task.max_steps - int(left)
    return episode_from_fields(task, ground, int(drone), int(battery), steps, parcels, reward_profile)


def read_observations(
    task: TaskConfig, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """The states of M observations.

    Args:
        task: The task.
        grids: uint8[M, height, width]
        telemetry: float32[M, telemetry_size]

    Returns:
        The grids without the drones, uint8[M, cells], and cell, units left and steps left of the drones, int64[M, 3].
    """
    x, y = drone_positions(task, grids, telemetry).T
    units = np.rint(telemetry[:, 2] * task.battery_capacity)
    left = np.rint(telemetry[:, 5] * task.max_steps) if task.telemetry_size > 5 else units
    drones = np.stack([y * task.width + x, units, left], axis=1).astype(np.int64)
    if not ((drones[:, 1:] >= 0) & (drones[:, 1:] <= (task.battery_capacity, task.max_steps))).all():
        raise InvalidValueError(f"an observation has battery or steps left that {task.id!r} does not have")
    grounds = grids.reshape(len(grids), -1).copy()
    if task.telemetry_size > 6:
        below: Any = np.array(TERRAIN)[telemetry[:, 6:].argmax(axis=1)]
    else:
        below = [hidden_kind(task, ground) for ground in grounds]
    grounds[np.arange(len(grids)), drones[:, 0]] = below
    return grounds, drones


def hidden_kind(task: TaskConfig, grid: npt.NDArray[np.uint8]) -> int:
    """The kind of the cell below the drone if telemetry does not contain it: the kind with too few visible cells."""
    shown = np.bincount(grid, minlength=N_CELL_KINDS)
    if shown[Cell.DELIVERY] + shown[Cell.DELIVERED] < task.deliveries:
        return Cell.DELIVERED
    missing = [kind for kind, count in task.cell_counts().items() if shown[kind] < count]
    return missing[0] if missing else Cell.ROAD


def drone_positions(
    task: TaskConfig, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]
) -> npt.NDArray[np.int64]:
    """(x, y) of the drones of N observations, int64[N, 2]. It checks shapes and ids, because compiled code does not.

    Args:
        task: The task.
        grids: uint8[N, H, W]
        telemetry: float32[N, telemetry_size]
    """
    n, sides = len(grids), (task.width, task.height)
    if grids.shape != (n, *sides[::-1]) or telemetry.shape != (n, task.telemetry_size) or grids.dtype != np.uint8:
        expected = f"grids uint8[N, {task.height}, {task.width}] and telemetry float32[N, {task.telemetry_size}]"
        got = " and ".join(f"{array.dtype}{list(array.shape)}" for array in (grids, telemetry))
        raise InvalidValueError(f"observations of {task.id!r} are {expected}; got {got}")
    if (grids >= N_CELL_KINDS).any():
        raise InvalidValueError(f"the kinds of cells are 0 to {N_CELL_KINDS - 1}, got {grids.max()}")
    positions = np.rint(telemetry[:, :2] * np.array(sides))
    if not ((positions >= 0) & (positions < sides)).all():
        raise InvalidValueError(f"the drone of an observation is outside the grid of {task.id!r}")
    return positions.astype(np.int64)
