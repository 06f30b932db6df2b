"""The states of one map with the drone at each cell, and the cells in range of its battery.

Battery, steps, delivered parcels and current target do not change with the cell. But a drone at the cell of a waiting
parcel delivers it, and a drone at a pad has not charged yet.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import FLYING
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, Cell
from drone_env.core.compiled import kernel
from drone_env.core.episode import Episode
from drone_env.core.rewards import Rewards, tabulate_rewards
from drone_env.core.rules import choose_target, deliver, manhattan, outcome, step, write_telemetry
from drone_env.core.tables import (
    BATTERY,
    CELL,
    DELIVERIES_DONE,
    DISTANCE,
    N_MOVES,
    NOWHERE,
    OUTCOME,
    STEPS,
    TARGET,
    UNDER,
    Tables,
    interpreted,
    tabulate,
    view,
)
from drone_env.planning.states import UNPAID, put_drone, state_arrays

UNREACHED = -1
MAX_CHUNK_CELLS = 256
"""Maximum number of cells per chunk: each has a grid, and all 3,600 of a city take 16 MB."""


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
    """The states with the drone at these cells, or at all cells that it can enter. The episode is not changed."""
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
