"""States of one map as arrays for kernels, limits of their memory, and the range of the battery."""

from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import FLYING, N_ACTIONS
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, DRONE_CELL, Cell
from drone_env.core.compiled import jitable
from drone_env.core.episode import Episode
from drone_env.core.rewards import RewardProfile
from drone_env.core.tables import (
    BATTERY,
    CELL,
    DELIVERED_FLAG,
    DELIVERIES_DONE,
    OUTCOME,
    PARCELS,
    STEPS,
    UNDER,
    Tables,
    tabulate,
)
from drone_env.core.tasks import TaskConfig
from drone_env.errors import TooLargeError

MAX_BYTES = 1 << 30
"""Maximum working memory of a planner for one map."""
UNPAID = RewardProfile(id="none", summary="nothing")
"""A profile for planners that need no reward."""


@jitable
def put_parcels(tables: Tables, grid: Any, state: Any, parcels: Any, delivered: int) -> None:
    """Set the delivered parcels, in a state without a drone on its grid.

    Args:
        tables: The task's tables.
        grid: uint8[cells], without the drone.
        state: uint16[state size].
        parcels: int64[n], the entries of `state` of the parcels that were waiting at the start.
        delivered: The set of delivered ones, bit i for the i-th entry.
    """
    state[DELIVERIES_DONE] = tables.deliveries - len(parcels)
    for i in range(len(parcels)):
        cell = state[parcels[i]] & (DELIVERED_FLAG - 1)
        if delivered >> i & 1:
            state[parcels[i]] = cell + DELIVERED_FLAG
            state[DELIVERIES_DONE] += 1
            grid[cell] = DELIVERED_CELL
        else:
            state[parcels[i]] = cell
            grid[cell] = DELIVERY_CELL


@jitable
def put_drone(tables: Tables, grid: Any, state: Any, cell: int, steps: int, battery: int) -> None:
    """Put the drone, in flight, over a cell of a grid without a drone. The caller sets the target."""
    state[CELL] = cell
    state[UNDER] = grid[cell]
    state[STEPS] = steps
    state[BATTERY] = battery
    state[OUTCOME] = FLYING
    grid[cell] = DRONE_CELL


@jitable
def delivered_set(state: Any, parcels: Any) -> int:
    """The set of delivered parcels, bit i for the i-th entry of `parcels`."""
    delivered = 0
    for i in range(len(parcels)):
        if state[parcels[i]] >= DELIVERED_FLAG:
            delivered |= 1 << i
    return delivered


def waiting_parcels(episode: Episode) -> list[int]:
    """The numbers of the undelivered parcels."""
    return [i for i, (_, _, delivered) in enumerate(episode.parcels) if not delivered]


def state_arrays(episode: Episode) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16], npt.NDArray[np.int64]]:
    """Copies of the grid without the drone and of the state, and the entries of the state with waiting parcels."""
    grid = episode.grid().ravel()
    grid[episode.cell] = episode.under
    state = np.frombuffer(episode.get_state().numbers, np.uint16).copy()
    return grid, state, PARCELS + np.array(waiting_parcels(episode), np.int64)


def require_memory(what: str, task: TaskConfig, size: int) -> None:
    """Check the memory that a planner needs; `what` is the subject of the message.

    Raises:
        TooLargeError: if `size`, in bytes, is above `MAX_BYTES`.
    """
    if size > MAX_BYTES:
        raise TooLargeError(
            f"{what} of a map of {task.id!r} would take {size / 1e9:.1f} GB; {MAX_BYTES / 1e9:.1f} GB are allowed"
        )


def battery_ranges(episode: Episode) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The range of the battery after each of the T steps left, while the episode has not ended.

    Returns:
        int64[T + 1], the lowest number of units above 0, and int64[T], the number of values from it on.
    """
    task = episode.task
    kinds = [Cell.ROAD, Cell.DELIVERY, Cell.DELIVERED, *(kind for kind, count in task.cell_counts().items() if count)]
    drains = np.reshape(tabulate(task).drain, (-1, N_ACTIONS))[[kind for kind in kinds if kind not in task.impassable]]
    least_drain, most_drain = int(drains.min()), int(drains.max())
    lowest, sizes = [], []
    low = high = episode.battery_units
    for _ in range(task.max_steps - episode.steps):
        lowest.append(low)
        sizes.append(max(high - low + 1, 0))
        low, high = max(low - most_drain, 1), min(high - least_drain, task.battery_capacity)
    lowest.append(low)
    return np.array(lowest, np.int64), np.array(sizes, np.int64)
