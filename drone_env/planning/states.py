"""States of one map as arrays for kernels, limits of their memory, and the range of the battery.

`states_at_cells` and `battery_range` place the drone of an episode at other cells. Battery, steps, delivered parcels
and current target do not change. But a drone at the cell of a waiting parcel delivers it, and a drone at a pad has not
charged yet.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import FLYING, N_ACTIONS
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, DRONE_CELL, Cell
from drone_env.core.compiled import jitable, kernel
from drone_env.core.episode import Episode
from drone_env.core.rewards import RewardProfile, Rewards, tabulate_rewards
from drone_env.core.rules import choose_target, deliver, manhattan, outcome, step, write_telemetry
from drone_env.core.tables import (
    BATTERY,
    CELL,
    DELIVERED_FLAG,
    DELIVERIES_DONE,
    DISTANCE,
    N_MOVES,
    NOWHERE,
    OUTCOME,
    PARCELS,
    STEPS,
    TARGET,
    UNDER,
    Tables,
    interpreted,
    tabulate,
    view,
)
from drone_env.core.tasks import TaskConfig
from drone_env.errors import TooLargeError

MAX_BYTES = 1 << 30
"""Maximum working memory of a planner for one map."""
UNPAID = RewardProfile(id="none", summary="nothing")
"""A profile for planners that need no reward."""
UNREACHED = -1
MAX_CHUNK_CELLS = 256
"""Maximum number of cells per chunk: each has a grid, and all 3,600 of a city take 16 MB."""


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


def drain_range(task: TaskConfig) -> tuple[int, int]:
    """The lowest and highest drain of a step on any map of the task; negative for a charge."""
    kinds = [Cell.ROAD, Cell.DELIVERY, Cell.DELIVERED, *(kind for kind, count in task.cell_counts().items() if count)]
    drains = np.reshape(tabulate(task).drain, (-1, N_ACTIONS))[[kind for kind in kinds if kind not in task.impassable]]
    return int(drains.min()), int(drains.max())


def battery_ranges(episode: Episode) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The range of the battery after each of the T steps left, while the episode has not ended.

    Returns:
        int64[T + 1], the lowest number of units above 0, and int64[T], the number of values from it on.
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


class CellStates(NamedTuple):
    """The states of an episode with its drone at each of N cells, in ascending order."""

    cells: npt.NDArray[np.int64]
    """int64[N]"""
    grids: npt.NDArray[np.uint8]
    """uint8[N, cells]"""
    states: npt.NDArray[np.uint16]
    """uint16[N, state size]"""
    telemetry: npt.NDArray[np.float32]
    """float32[N, telemetry_size]"""

    @property
    def flying(self) -> npt.NDArray[np.bool_]:
        """bool[N], False if the drone delivers the last parcel there."""
        return self.states[:, OUTCOME] == FLYING


def states_at_cells(episode: Episode, cells: npt.NDArray[np.int64] | None = None) -> CellStates:
    """The states with the drone at these cells, or at all cells that it can enter. The episode is not changed.

    Raises:
        EpisodeError: if the episode has not started.
    """
    task, tables = episode.task, interpreted(episode.task)
    grid, state, _ = state_arrays(episode)
    cells = open_cells(episode) if cells is None else cells
    n = len(cells)
    telemetry = np.zeros((n, task.telemetry_size), np.float32)
    places = CellStates(cells, np.tile(grid, (n, 1)), np.tile(state, (n, 1)), telemetry)
    for cell, *arrays in zip(cells.tolist(), places.grids, places.states, telemetry, strict=True):
        grid, state, values = map(view, arrays)
        put_drone(tables, grid, state, cell, state[STEPS], state[BATTERY])
        if state[UNDER] == DELIVERY_CELL:
            deliver(tables, state)
            state[OUTCOME] = outcome(tables, state[DELIVERIES_DONE], state[BATTERY], state[STEPS])
        if state[TARGET] != NOWHERE:
            state[DISTANCE] = manhattan(tables, cell, state[TARGET])
        write_telemetry(tables, state, values)
    return places


def states_in_chunks(episode: Episode) -> Iterator[CellStates]:
    """Yield the states of all cells in chunks, to limit memory; raises as `states_at_cells`."""
    cells = open_cells(episode)
    for first in range(0, len(cells), MAX_CHUNK_CELLS):
        yield states_at_cells(episode, cells[first : first + MAX_CHUNK_CELLS])


def open_cells(episode: Episode) -> npt.NDArray[np.int64]:
    """The cells that the drone can enter, in ascending order."""
    grid, _, _ = state_arrays(episode)
    return np.flatnonzero(~np.isin(grid, list(episode.task.impassable)))


@kernel
def range_kernel(
    tables: Tables, rewards: Rewards, ground: Any, start: Any, most: Any, grid: Any, state: Any, reached: Any
) -> None:
    """Fly all moves in rounds, from each cell that the last round reached with more units than before.

    Args:
        tables: The task's tables.
        rewards: Tables of any profile; not used.
        ground: uint8[cells], without the drone.
        start: uint16[state size], in flight.
        most: int64[cells], all `UNREACHED`; receives the most units left on arrival.
        grid: uint8[cells], a copy of `ground`; working memory, like the following arrays.
        state: uint16[state size]
        reached: int64[2, cells], all `UNREACHED`: units at the cells that the last and the current round improved.
    """
    most[start[CELL]] = reached[0, start[CELL]] = start[BATTERY]
    last, this, improved = 0, 1, True
    for steps in range(start[STEPS], tables.max_steps):
        if not improved:
            break
        improved = False
        for cell in range(tables.cells):
            reached[this, cell] = UNREACHED
        for cell in range(tables.cells):
            units = reached[last, cell]
            if units <= 0:  # the battery is empty
                continue
            for action in range(N_MOVES):
                for i in range(len(start)):
                    state[i] = start[i]
                put_drone(tables, grid, state, cell, steps, units)
                if state[UNDER] == DELIVERY_CELL:
                    state[UNDER] = DELIVERED_CELL
                choose_target(tables, state)
                step(tables, rewards, grid, state, action)
                to, left = int(state[CELL]), int(state[BATTERY])
                grid[cell], grid[to] = ground[cell], ground[to]
                if left > most[to]:
                    most[to] = reached[this, to] = left
                    improved = True
        last, this = this, last


def battery_range(episode: Episode, cell: int, units: int) -> npt.NDArray[np.int64]:
    """The most battery units that a drone can have left at each cell, by moves in the steps left.

    0 means that the drone reaches the cell with its last unit. Deliveries do not end the flight here.

    Args:
        episode: An episode in flight; it is not changed.
        cell: Start cell.
        units: Battery units at the start.

    Returns:
        int64[cells], `UNREACHED` for cells out of range.

    Raises:
        EpisodeError: if the episode has not started.
    """
    task = episode.task
    ground, state, _ = state_arrays(episode)
    start = state.copy()
    start[[CELL, BATTERY]] = cell, units
    most, reached = np.full(len(ground), UNREACHED), np.full((2, len(ground)), UNREACHED)
    rewards = tabulate_rewards(task, UNPAID)
    range_kernel(tabulate(task), rewards, ground, start, most, ground.copy(), state, reached)
    return most


def charging_pads(episode: Episode) -> list[int]:
    """The cells where waiting charges, in ascending order."""
    grid, _, _ = state_arrays(episode)
    return np.flatnonzero(grid == Cell.PAD).tolist() if episode.task.charge_rate else []
