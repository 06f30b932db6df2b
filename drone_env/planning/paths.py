"""Paths over terrain, compiled: Pareto-optimal paths to stops (parcels and pads), and cheapest paths.

A path with fewer battery units may take more steps. A path that is worse in one and not better in the other is never
part of a best flight. Labels are corrected in rounds (Bellman, "On a routing problem", 1958; two criteria: Hansen,
"Bicriterion path problems", 1980).
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import N_ACTIONS, WAIT
from drone_env.core.cells import DELIVERY_CELL, PAD_CELL
from drone_env.core.compiled import jitable, kernel
from drone_env.core.rules import NONE, collision
from drone_env.core.tables import N_MOVES, Tables, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.planning.states import require_memory

UNREACHED = 1 << 30
NO_STOP = -1
NO_PATH = 1 << 40
NO_ACTION = -1
STEP_COST = 1
UNIT_COST = 1 << 16
"""More than the steps of any path, so battery counts first."""


class ParetoPaths(NamedTuple):
    """The Pareto-optimal paths to N stops, from one cell or several.

    Steps increase and units decrease along each row: the first path is the fastest, the last the cheapest.
    """

    count: Any
    """int64[N], number of paths."""
    units: Any
    """int32[N, most paths], battery units that a path drains; the last step may need more than the battery has."""
    steps: Any
    """int32[N, most paths], steps of a path."""
    first: Any
    """int32[N, most paths], first action of a path."""


class PathSearch(NamedTuple):
    """A map, the paths from one of its cells or several to its stops, and working memory of `find_paths`."""

    tables: Tables
    counts: Any
    """1 if units count; 0 if every step drains one unit, so that only steps count and paths drain nothing."""
    ground: Any
    """uint8[cells], the kind of each cell without the drone; `Cell.DELIVERY` is a waiting parcel."""
    stop_at: Any
    """int32[cells], the number of the stop at each cell, or `NO_STOP`."""
    paths: ParetoPaths
    fewest: Any
    """int32[cells], units of the cheapest path so far."""
    action: Any
    """int32[cells], its first action."""
    reached_in: Any
    """int32[cells], the last round that found a cheaper path."""
    last: Any
    """int32[3, cells]: cell, units and first action of the cells that the last round reached."""
    next: Any
    """int32[3, cells], those of the current round."""


def make_search(task: TaskConfig, paths: int) -> PathSearch:
    """Allocate the search on a map without stops, for paths from cells to stops, this many pairs in all.

    Raises:
        TooLargeError: if it would take more memory than `states.MAX_BYTES`.
    """
    require_memory("the paths", task, 12 * paths * most_paths(task))
    tables, cells = tabulate(task), task.width * task.height
    found = ParetoPaths(np.zeros(paths, np.int64), *np.zeros((3, paths, most_paths(task)), np.int32))
    ground, stop_at = np.zeros(cells, np.uint8), np.full(cells, NO_STOP, np.int32)
    working_memory = (*np.zeros((3, cells), np.int32), *np.zeros((2, 3, cells), np.int32))
    return PathSearch(tables, int(not task.uniform), ground, stop_at, found, *working_memory)


def most_paths(task: TaskConfig) -> int:
    """The largest number of Pareto-optimal paths to one stop."""
    # Each further path takes at least one step more and one unit less.
    return 1 if task.uniform else min(task.battery_capacity + 1, task.width * task.height)


@jitable
def least_units(tables: Tables, at_parcel: Any) -> int:
    """The fewest units that a drone has left after a path to a parcel, or to another stop.

    The last step to a parcel may drain more than the battery has: the drone still delivers, and the number is negative.
    """
    return 1 - tables.drain[DELIVERY_CELL * N_ACTIONS] if at_parcel else 1


@jitable
def waits_until_full(tables: Tables, units: int) -> int:
    """The number of waits on a pad until a battery with these units is full; 0 if pads do not charge."""
    charge = -tables.drain[PAD_CELL * N_ACTIONS + WAIT]
    return (tables.capacity - units + charge - 1) // charge if charge > 0 else 0


@jitable
def find_paths(search: PathSearch, start: int, most: int, base: int) -> None:
    """Find all Pareto-optimal paths from a cell to each stop. A path ends at a waiting parcel, which it delivers.

    Args:
        search: The map; receives the paths, those to stop i at entry `base` + i.
        start: The first cell.
        most: Units of the drone. Only the last step to a waiting parcel may use up all of them.
        base: The first entry of this cell.
    """
    tables, counts, ground, stop_at, paths, fewest, action_of, reached_in, last, reached = search
    moves: Any = tables.moves
    drain: Any = tables.drain
    for cell in range(tables.cells):
        fewest[cell] = UNREACHED
        reached_in[cell] = 0
        if stop_at[cell] != NO_STOP:
            paths.count[base + stop_at[cell]] = 0
    fewest[start] = 0
    last[0, 0], last[1, 0], last[2, 0] = start, 0, 0
    n_last, steps = 1, 0
    while n_last > 0:
        steps += 1
        n_reached = 0
        for k in range(n_last):
            cell = last[0, k]
            if ground[cell] == DELIVERY_CELL and cell != start:
                continue
            for action in range(N_MOVES):
                to = moves[cell * N_ACTIONS + action]
                if collision(tables, ground, to) != NONE:
                    continue
                units = last[1, k] + counts * drain[ground[to] * N_ACTIONS + action]
                if units >= fewest[to] or (units >= most and ground[to] != DELIVERY_CELL):
                    continue
                if reached_in[to] != steps:
                    reached_in[to] = steps
                    reached[0, n_reached] = to
                    n_reached += 1
                fewest[to] = units
                action_of[to] = action if steps == 1 else last[2, k]
        for k in range(n_reached):
            cell = reached[0, k]
            reached[1, k] = fewest[cell]
            reached[2, k] = action_of[cell]
            if stop_at[cell] != NO_STOP:
                stop = base + stop_at[cell]
                n = paths.count[stop]
                paths.units[stop, n] = fewest[cell]
                paths.steps[stop, n] = steps
                paths.first[stop, n] = action_of[cell]
                paths.count[stop] = n + 1
        last, reached = reached, last
        n_last = n_reached


@jitable
def find_costs(tables: Tables, grid: Any, kind_costs: Any, through: Any, costs: Any, first: Any) -> None:
    """Find the cost of the cheapest path to each cell, and its first action (Bellman-Ford).

    Args:
        tables: The task's tables.
        grid: uint8[cells], cell ids.
        kind_costs: int64[kinds], cost of a move onto each kind of cell.
        through: Whether paths lead on beyond waiting parcels; else they end there.
        costs: int64[cells], 0 at the starts, else `NO_PATH`; receives the costs.
        first: int64[cells], all `NO_ACTION`; receives the actions.
    """
    changed = True
    while changed:
        changed = False
        for cell in range(tables.cells):
            ends = not through and grid[cell] == DELIVERY_CELL and costs[cell] != 0
            if costs[cell] == NO_PATH or ends:
                continue
            for action in range(N_MOVES):
                to = tables.moves[cell * N_ACTIONS + action]
                if collision(tables, grid, to) != NONE:
                    continue
                cost = costs[cell] + kind_costs[grid[to]]
                if cost < costs[to]:
                    costs[to] = cost
                    first[to] = action if first[cell] == NO_ACTION else first[cell]
                    changed = True


@kernel
def cost_kernel(tables: Tables, grids: Any, starts: Any, kind_costs: Any, costs: Any, first: Any) -> None:
    """`find_costs` on N maps, each from one start."""
    for i in range(len(grids)):
        costs[i, starts[i]] = 0
        find_costs(tables, grids[i], kind_costs, True, costs[i], first[i])


def cheapest_paths(
    task: TaskConfig, grids: npt.NDArray[np.uint8], starts: npt.NDArray[np.int64]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The cheapest paths from one cell of each of N maps to all cells: battery counts first, then steps.

    Args:
        task: The task.
        grids: uint8[N, cells], as the drones see them.
        starts: int64[N], the first cells.

    Returns:
        int64[N, cells] each: the costs (`UNIT_COST` per battery unit, `STEP_COST` per step) or `NO_PATH`, and the first
        actions or `NO_ACTION`.
    """
    tables, shape = tabulate(task), (len(grids), task.width * task.height)
    costs, first = np.full(shape, NO_PATH), np.full(shape, NO_ACTION)
    cost_kernel(tables, grids, starts, move_costs(tables), costs, first)
    return costs, first


def cheapest_ways(
    task: TaskConfig, grid: npt.NDArray[np.uint8], start: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """The units that the cheapest path from a cell to each other cell drains, or -1; and its first action.

    As `cheapest_paths`, for one map: uint8[cells] to int64[cells] each.
    """
    (costs,), (first,) = cheapest_paths(task, grid[None], np.array([start]))
    return np.where(costs == NO_PATH, -1, costs // UNIT_COST), first


def move_costs(tables: Tables) -> npt.NDArray[np.int64]:
    """int64[kinds], the cost of a move onto each kind of cell: battery counts first, then steps."""
    return np.reshape(tables.drain, (-1, N_ACTIONS))[:, 0] * np.int64(UNIT_COST) + STEP_COST
