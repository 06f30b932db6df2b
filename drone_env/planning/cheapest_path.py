"""The cheapest ways to parcels over terrain, compiled: least battery first, then fewest steps.

Bellman, "On a routing problem", 1958: labels are corrected in sweeps over the map until none changes.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core import compiled
from drone_env.core.actions import N_ACTIONS, Action
from drone_env.core.cells import DELIVERY_CELL
from drone_env.core.compile_cache import compiled_once
from drone_env.core.obstacles import NONE, collision
from drone_env.core.tables import Tables, tabulate
from drone_env.core.tasks import TaskConfig

WAIT = int(Action.WAIT)
UNREACHED = 1 << 40
STEP_COST = 1
UNIT_COST = 1 << 16
"""More than the steps of any way, so that battery always counts first."""


def cheapest_action(tables: Tables, grid: Any, start: int, costs: Any, first: Any) -> int:
    """The first action of the cheapest way to the parcel that is cheapest to reach; WAIT if there is none.

    Of equally cheap parcels the first in reading order.

    Args:
        tables: The task's tables.
        grid: [cells], cell ids.
        start: The cell to start from.
        costs: [cells], receives the cost of the way to each cell, `UNREACHED` where there is none.
        first: [cells], receives the first action of that way.
    """
    for cell in range(tables.cells):
        costs[cell] = UNREACHED
    costs[start] = 0
    first[start] = WAIT
    changed = True
    while changed:
        changed = False
        for cell in range(tables.cells):
            if costs[cell] == UNREACHED:
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
        if grid[cell] == DELIVERY_CELL and costs[cell] < UNREACHED and (best < 0 or costs[cell] < costs[best]):
            best = cell
    return WAIT if best < 0 else first[best]


register_jitable(**compiled.OPTIONS)(cheapest_action)


@compiled_once(nogil=True, **compiled.OPTIONS)
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
