"""Paths over terrain, compiled: the Pareto-optimal ones to stops (parcels and pads), and the cheapest to a parcel.

A path that costs fewer battery units may take more steps, and the other way round; a path that is no better in either
is never part of a best flight. Labels are corrected round by round (Bellman, "On a routing problem", 1958; two
criteria: Hansen, "Bicriterion path problems", 1980).
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import N_ACTIONS, Action
from drone_env.core.cells import DELIVERY_CELL
from drone_env.core.compiled import jitable, kernel
from drone_env.core.rules import NONE, collision
from drone_env.core.tables import N_MOVES, Tables, tabulate
from drone_env.core.tasks import TaskConfig

WAIT = int(Action.WAIT)
UNREACHED = 1 << 30
NO_STOP = -1
NO_PATH = 1 << 40
STEP_COST = 1
UNIT_COST = 1 << 16
"""More than the steps of any path, so that battery always counts first."""


class ParetoPaths(NamedTuple):
    """The Pareto-optimal paths to N stops, from one cell or from several.

    They are in the order of rising steps and falling units: the first is the fastest, the last the cheapest.
    """

    count: Any
    """int64[N], how many there are."""
    units: Any
    """int32[N, most paths], battery units that they drain; the last step may ask for more than is left."""
    steps: Any
    """int32[N, most paths], their steps."""
    first: Any
    """int32[N, most paths], their first action."""


class Workspace(NamedTuple):
    """Working memory of `find_paths`: of each cell, and of the cells that the last round and this one reached."""

    fewest: Any
    """int32[cells], units of the cheapest path so far."""
    action: Any
    """int32[cells], its first action."""
    reached_in: Any
    """int32[cells], the last round that found a cheaper path."""
    last: Any
    """int32[3, cells]: cell, units and first action."""
    next: Any
    """int32[3, cells]"""


def make_paths(task: TaskConfig, stops: int) -> ParetoPaths:
    """Room for the paths to this many stops."""
    return ParetoPaths(np.zeros(stops, np.int64), *np.zeros((3, stops, most_paths(task)), np.int32))


def most_paths(task: TaskConfig) -> int:
    """The largest number of Pareto-optimal paths to one stop."""
    # Of n paths each takes a step more and a unit less than the one before.
    return min(task.battery_capacity + 1, task.width * task.height) if counts_units(task) else 1


def make_workspace(task: TaskConfig) -> Workspace:
    """Working memory for a map of the task."""
    cells = task.width * task.height
    return Workspace(*np.zeros((3, cells), np.int32), *np.zeros((2, 3, cells), np.int32))


def counts_units(task: TaskConfig) -> bool:
    """Whether units are worth counting beside steps: not where each step drains one, whatever it is."""
    return not task.uniform


@jitable
def find_paths(
    tables: Tables,
    ground: Any,
    start: int,
    most: int,
    counts: int,
    stop_at: Any,
    paths: ParetoPaths,
    base: int,
    workspace: Workspace,
) -> None:
    """Find all Pareto-optimal paths from a cell to each stop. A waiting parcel ends a path: it is delivered there.

    Args:
        tables: The task's tables.
        ground: uint8[cells], the kind of each cell, without the drone; a parcel waits where it is `Cell.DELIVERY`.
        start: The first cell.
        most: Units of the drone: a path leaves some of them, or takes the last with the step to a waiting parcel.
        counts: 1 if units count, 0 if only steps do: a path then drains none.
        stop_at: int32[cells], the number of the stop at each cell, or `NO_STOP`.
        paths: Receives the paths, those to stop i at entry `base` + i.
        base: Where the entries of this cell begin.
        workspace: Working memory.
    """
    fewest, action_of, reached_in = workspace.fewest, workspace.action, workspace.reached_in
    moves: Any = tables.moves
    drain: Any = tables.drain
    last: Any = workspace.last
    reached: Any = workspace.next
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
def cheapest_action(tables: Tables, grid: Any, start: int, costs: Any, first: Any) -> int:
    """The first action of the cheapest path to the parcel that is cheapest to reach; WAIT if there is none.

    Least battery first, then fewest steps; of equally cheap parcels the first in reading order.

    Args:
        tables: The task's tables.
        grid: [cells], cell ids.
        start: The cell to start from.
        costs: [cells], receives the cost of the path to each cell, `NO_PATH` where there is none.
        first: [cells], receives the first action of that path.
    """
    for cell in range(tables.cells):
        costs[cell] = NO_PATH
    costs[start] = 0
    first[start] = WAIT
    changed = True
    while changed:
        changed = False
        for cell in range(tables.cells):
            if costs[cell] == NO_PATH:
                continue
            for action in range(WAIT):
                to = tables.moves[cell * N_ACTIONS + action]
                if collision(tables, grid, to) != NONE:
                    continue
                cost = costs[cell] + tables.drain[grid[to] * N_ACTIONS + action] * UNIT_COST + STEP_COST  # pyright: ignore[reportUnknownVariableType]
                if cost < costs[to]:
                    costs[to] = cost
                    first[to] = action if cell == start else first[cell]
                    changed = True
    best = -1
    for cell in range(tables.cells):
        if grid[cell] == DELIVERY_CELL and costs[cell] < NO_PATH and (best < 0 or costs[cell] < costs[best]):
            best = cell
    return WAIT if best < 0 else first[best]


@kernel
def cheapest_kernel(tables: Tables, grids: Any, starts: Any, costs: Any, first: Any, actions: Any) -> None:
    """Write the action of each map."""
    for i in range(len(grids)):
        actions[i] = cheapest_action(tables, grids[i], starts[i], costs, first)


def cheapest_actions(
    task: TaskConfig, grids: npt.NDArray[np.uint8], starts: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """`cheapest_action` on N maps.

    Args:
        task: The task.
        grids: uint8[N, height, width], as the drones see them.
        starts: int64[N, 2], (x, y) of the drones.

    Returns:
        int64[N], the actions.
    """
    tables = tabulate(task)
    actions = np.zeros(len(grids), np.int64)
    cells = starts[:, 1] * task.width + starts[:, 0]
    costs, first = np.zeros((2, tables.cells), np.int64)
    cheapest_kernel(tables, np.reshape(grids, (len(grids), tables.cells)), cells, costs, first, actions)
    return actions
