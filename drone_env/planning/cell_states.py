"""The states of one map with the drone at each cell, and the cells in range of its battery.

Battery, steps, delivered parcels and current target do not change with the cell. But a drone at the cell of a waiting
parcel delivers it, and a drone at a pad has not charged yet.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import FLYING, N_ACTIONS
from drone_env.core.cells import DELIVERY_CELL, Cell
from drone_env.core.episode import Episode
from drone_env.core.rules import deliver, manhattan, outcome, write_telemetry
from drone_env.core.tables import (
    BATTERY,
    DELIVERIES_DONE,
    DISTANCE,
    NOWHERE,
    OUTCOME,
    STEPS,
    TARGET,
    UNDER,
    interpreted,
    tabulate,
    view,
)
from drone_env.planning.paths import cheapest_ways
from drone_env.planning.states import put_drone, state_arrays

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
    tables, (grid, state, _) = interpreted(episode.task), state_arrays(episode)
    cells = open_cells(episode) if cells is None else cells
    n = len(cells)
    telemetry = np.zeros((n, tables.telemetry_size), np.float32)
    places = CellStates(cells, np.tile(grid, (n, 1)), np.tile(state, (n, 1)), telemetry)
    for cell, *arrays in zip(cells.tolist(), *places[1:], strict=True):
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


def battery_range(episode: Episode, cell: int, units: int) -> npt.NDArray[np.int64]:
    """The most battery units that a drone can have left at each cell, by moves alone.

    0 means that the drone reaches the cell with its last unit. Deliveries do not end the flight here.

    Args:
        episode: An episode in flight; it is not changed.
        cell: Start cell.
        units: Battery units at the start.

    Returns:
        int64[cells], `UNREACHED` for cells out of range.
    """
    ground, _, _ = state_arrays(episode)
    drained, _ = cheapest_ways(episode.task, ground, cell)
    last = np.reshape(tabulate(episode.task).drain, (-1, N_ACTIONS))[ground, 0]
    # The last step may drain more than the battery has.
    in_range = (drained == 0) | ((drained > 0) & (drained - last < units))
    return np.where(in_range, np.maximum(units - drained, 0), UNREACHED)


def charging_pads(episode: Episode) -> list[int]:
    """The cells where waiting charges, in ascending order."""
    grid, _, _ = state_arrays(episode)
    return np.flatnonzero(grid == Cell.PAD).tolist() if episode.task.charge_rate else []
