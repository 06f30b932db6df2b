"""One map as a graph: where each action leads from each place, found by flying it by the rules.

A *place* is a cell together with the set of parcels delivered; its number is `delivered * cells + cell`, where bit i
of `delivered` stands for the i-th parcel that was waiting at the start of the planning. Where an action leads, what it
delivers and what it drains depend on nothing else; battery and steps only decide when the episode ends.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core import compiled
from drone_env.core.actions import FLYING, N_ACTIONS
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, DRONE_CELL, Cell
from drone_env.core.compile_cache import compiled_once
from drone_env.core.episode import Episode
from drone_env.core.rewards import RewardProfile, Rewards, tabulate_rewards
from drone_env.core.rules import choose_target, step
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
"""Working memory that a planner may take for one map."""


def put_parcels(tables: Tables, grid: Any, state: Any, parcels: Any, delivered: int) -> None:
    """Set which of the parcels are delivered, in a state without a drone on its grid.

    Args:
        tables: The task's tables.
        grid: uint8[cells], without the drone.
        state: uint16[state size].
        parcels: int64[n], the entries of `state` that hold the parcels that were waiting at the start.
        delivered: Bit i for parcel i of these.
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


def put_drone(tables: Tables, grid: Any, state: Any, cell: int, steps: int, battery: int) -> None:
    """Put the drone over a cell of a grid that has none, in flight; the caller chooses the target."""
    state[CELL] = cell
    state[UNDER] = grid[cell]
    state[STEPS] = steps
    state[BATTERY] = battery
    state[OUTCOME] = FLYING
    grid[cell] = DRONE_CELL


def delivered_set(state: Any, parcels: Any) -> int:
    """Which of the parcels are delivered, bit i for parcel i."""
    delivered = 0
    for i in range(len(parcels)):
        if state[parcels[i]] >= DELIVERED_FLAG:
            delivered |= 1 << i
    return delivered


for function in (put_parcels, put_drone, delivered_set):
    register_jitable(**compiled.OPTIONS)(function)


@compiled_once(nogil=True, **compiled.OPTIONS)
def explore(tables: Tables, rewards: Rewards, grid: Any, state: Any, parcels: Any, leads_to: Any, drain: Any) -> None:
    """Fly every action from every place that the drone can be at.

    A step from a full battery shows a drain, a step with one unit left shows a charge. With all parcels delivered the
    episode is over: those places lead nowhere.
    """
    for delivered in range((1 << len(parcels)) - 1):
        for cell in range(tables.cells):
            put_parcels(tables, grid, state, parcels, delivered)
            if grid[cell] == DELIVERY_CELL or tables.impassable[grid[cell]]:
                continue
            under = grid[cell]
            place = delivered * tables.cells + cell
            for action in range(N_ACTIONS):
                units = 0
                for battery in (1, tables.capacity):
                    put_drone(tables, grid, state, cell, 0, battery)
                    choose_target(tables, state)
                    step(tables, rewards, grid, state, action)
                    after = delivered_set(state, parcels)
                    leads_to[place, action] = after * tables.cells + state[CELL]
                    if battery == 1:
                        units = 1 - state[BATTERY]
                    if battery == tables.capacity and state[BATTERY] < tables.capacity:
                        units = tables.capacity - state[BATTERY]
                    grid[state[CELL]] = state[UNDER]
                    put_parcels(tables, grid, state, parcels, delivered)
                    grid[cell] = under
                drain[place, action] = units


class MapGraph(NamedTuple):
    """The places of one map, from a state of flight on with n parcels still to deliver.

    Attributes:
        tables: The tables of the task, as arrays.
        leads_to: int32[2^n * cells, 5], the place that an action leads to; -1 from places where no drone can fly on.
        drain: int16[2^n * cells, 5], battery units that it costs, below zero where it charges.
        done: int64[2^n], parcels delivered in all, for each delivered set.
    """

    tables: Tables
    leads_to: npt.NDArray[np.int32]
    drain: npt.NDArray[np.int16]
    done: npt.NDArray[np.int64]


def waiting_parcels(episode: Episode) -> list[int]:
    """The numbers of the parcels still to deliver."""
    return [i for i, (_, _, delivered) in enumerate(episode.parcels) if not delivered]


def state_arrays(episode: Episode) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16], npt.NDArray[np.int64]]:
    """The grid without the drone, the state, and which of its entries hold waiting parcels: copies, for kernels."""
    grid = episode.grid().ravel()
    grid[episode.cell] = episode.under
    state = np.frombuffer(episode.get_state().numbers, np.uint16).copy()
    return grid, state, PARCELS + np.array(waiting_parcels(episode), np.int64)


def map_graph(episode: Episode) -> MapGraph:
    """The graph of an episode's map from where the episode stands; the episode is left as it is.

    Its size is 2^n * cells, for n parcels still to deliver: callers check that first.
    """
    task = episode.task
    tables = tabulate(task)
    grid, state, parcels = state_arrays(episode)
    places = tables.cells << len(parcels)
    leads_to = np.full((places, N_ACTIONS), -1, np.int32)
    drain = np.zeros((places, N_ACTIONS), np.int16)
    explore(tables, tabulate_rewards(task, UNPAID), grid, state, parcels, leads_to, drain)
    done = [task.deliveries - len(parcels) + delivered.bit_count() for delivered in range(1 << len(parcels))]
    return MapGraph(tables, leads_to, drain, np.array(done, np.int64))


def require_memory(what: str, task: TaskConfig, size: int) -> None:
    """Refuse what would not fit; `what` names it in the message.

    Raises:
        TooLargeError: if `size`, in bytes, is above `MAX_BYTES`.
    """
    if size > MAX_BYTES:
        raise TooLargeError(
            f"{what} of a map of {task.id!r} would take {size / 1e9:.1f} GB; {MAX_BYTES / 1e9:.1f} GB are allowed"
        )


def drain_range(task: TaskConfig) -> tuple[int, int]:
    """The least and the most that a step can drain on any map of the task; below zero for a charge."""
    kinds = [Cell.ROAD, Cell.DELIVERY, Cell.DELIVERED, *(kind for kind, count in task.cell_counts().items() if count)]
    drains = np.reshape(tabulate(task).drain, (-1, N_ACTIONS))[[kind for kind in kinds if kind not in task.impassable]]
    return int(drains.min()), int(drains.max())


def battery_ranges(episode: Episode) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """What the battery can hold after each of the T steps that are left to an episode, as long as it goes on.

    Returns:
        int64[T + 1], the lowest number of units above 0; and int64[T], how many numbers from there on.
    """
    least_drain, most_drain = drain_range(episode.task)
    lowest, sizes = [], []
    low = high = episode.battery_units
    for _ in range(episode.task.max_steps - episode.steps):
        lowest.append(low)
        sizes.append(max(high - low + 1, 0))
        low, high = max(low - most_drain, 1), min(high - least_drain, episode.task.battery_capacity)
    lowest.append(low)
    return np.array(lowest, np.int64), np.array(sizes, np.int64)


UNPAID = RewardProfile(id="none", summary="nothing")
