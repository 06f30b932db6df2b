"""A flight as it would stand if the drone were at other cells, and which cells its battery takes it to.

All else stays as it is: the battery, the steps taken, the parcels delivered, the current target. A parcel that waits at
such a cell counts as delivered by arriving there; on a pad nothing has been charged yet.
"""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import FLYING
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, Cell
from drone_env.core.compiled import kernel
from drone_env.core.episode import Episode
from drone_env.core.observation import write_telemetry
from drone_env.core.rewards import Rewards, tabulate_rewards
from drone_env.core.rules import choose_target, deliver, manhattan, outcome, step
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
PLACES_AT_ONCE = 256
"""Maximum number of places per part: each has a grid, and all 3,600 of a city take 16 MB."""


class Places(NamedTuple):
    """The flight with its drone at each of N cells, in rising order."""

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
        """bool[N], whether the flight goes on from there: not where the last parcel is delivered by arriving."""
        return self.states[:, OUTCOME] == FLYING


def places_of(episode: Episode, cells: npt.NDArray[np.int64] | None = None) -> Places:
    """An episode in flight, with its drone at these cells, or each that it can be at; the episode is left as it is.

    Raises:
        EpisodeError: if the episode has not begun.
    """
    task, tables = episode.task, interpreted(episode.task)
    grid, state, _ = state_arrays(episode)
    cells = open_cells(episode) if cells is None else cells
    n = len(cells)
    telemetry = np.zeros((n, task.telemetry_size), np.float32)
    places = Places(cells, np.tile(grid, (n, 1)), np.tile(state, (n, 1)), telemetry)
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


def places_in_parts(episode: Episode) -> Iterator[Places]:
    """The same in parts of at most `PLACES_AT_ONCE` cells, which take little memory; raises as `places_of`."""
    cells = open_cells(episode)
    for first in range(0, len(cells), PLACES_AT_ONCE):
        yield places_of(episode, cells[first : first + PLACES_AT_ONCE])


def open_cells(episode: Episode) -> npt.NDArray[np.int64]:
    """The cells that the drone can be at, in rising order."""
    grid, _, _ = state_arrays(episode)
    return np.flatnonzero(~np.isin(grid, list(episode.task.impassable)))


@kernel
def range_kernel(
    tables: Tables, rewards: Rewards, ground: Any, begun: Any, most: Any, grid: Any, state: Any, reached: Any
) -> None:
    """Fly on from where a drone stands, by moves alone, round by round, wherever that leaves more units than before.

    Args:
        tables: The task's tables.
        rewards: Those of any profile: they are not used.
        ground: uint8[cells], without the drone.
        begun: uint16[state size], in flight.
        most: int64[cells], all `UNREACHED`; receives the most units that are left on arrival.
        grid: uint8[cells], equal to `ground`: working memory, as are the following.
        state: uint16[state size]
        reached: int64[2, cells], all `UNREACHED`: what the last round and this one have left where it is more.
    """
    most[begun[CELL]] = reached[0, begun[CELL]] = begun[BATTERY]
    last, this, found = 0, 1, True
    for steps in range(begun[STEPS], tables.max_steps):
        if not found:
            break
        found = False
        for cell in range(tables.cells):
            reached[this, cell] = UNREACHED
        for cell in range(tables.cells):
            units = reached[last, cell]
            if units <= 0:  # with none it moves no more
                continue
            for action in range(N_MOVES):
                for i in range(len(begun)):
                    state[i] = begun[i]
                put_drone(tables, grid, state, cell, steps, units)
                if state[UNDER] == DELIVERY_CELL:
                    state[UNDER] = DELIVERED_CELL
                choose_target(tables, state)
                step(tables, rewards, grid, state, action)
                to, left = int(state[CELL]), int(state[BATTERY])
                grid[cell], grid[to] = ground[cell], ground[to]
                if left > most[to]:
                    most[to] = reached[this, to] = left
                    found = True
        last, this = this, last


def battery_range(episode: Episode, cell: int, units: int) -> npt.NDArray[np.int64]:
    """The most battery units with which a drone gets to each cell by moves alone, in the steps that are left.

    With 0 it gets there on its last. Deliveries on the way cost nothing more, and do not end it.

    Args:
        episode: In flight; it is left as it is.
        cell: Where the drone starts.
        units: What it starts with.

    Returns:
        int64[cells], `UNREACHED` where it does not get.

    Raises:
        EpisodeError: if the episode has not begun.
    """
    task = episode.task
    ground, state, _ = state_arrays(episode)
    begun = state.copy()
    begun[[CELL, BATTERY]] = cell, units
    most, reached = np.full(len(ground), UNREACHED), np.full((2, len(ground)), UNREACHED)
    rewards = tabulate_rewards(task, UNPAID)
    range_kernel(tabulate(task), rewards, ground, begun, most, ground.copy(), state, reached)
    return most


def charging_pads(episode: Episode) -> list[int]:
    """The cells where waiting charges, in rising order."""
    grid, _, _ = state_arrays(episode)
    return np.flatnonzero(grid == Cell.PAD).tolist() if episode.task.charge_rate else []
