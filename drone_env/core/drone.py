"""The drone itself: how it moves over the grid and what that costs the battery."""

from drone_env.core.actions import N_ACTIONS
from drone_env.core.cells import DRONE_CELL
from drone_env.core.tables import BATTERY, CELL, UNDER, Buffer, Tables


def move(grid: Buffer, state: Buffer, cell: int, to: int) -> int:
    """Uncover the cell that the drone leaves, cover the one that it reaches, and return the kind of that one."""
    grid[cell] = state[UNDER]
    under = grid[to]
    state[CELL] = to
    state[UNDER] = under
    grid[to] = DRONE_CELL
    return under


def use_battery(tables: Tables, state: Buffer, under: int, action: int) -> int:
    """Drain, or charge, by the action and the kind of cell below the drone; return the units left."""
    units = units_left(tables, state[BATTERY], tables.drain[under * N_ACTIONS + action])
    state[BATTERY] = units
    return units


def units_left(tables: Tables, units: int, drain: int) -> int:
    """Battery units after a drain (below zero: a charge): never under 0 or over capacity."""
    return min(max(units - drain, 0), tables.capacity)


def distance(tables: Tables, a: int, b: int) -> int:
    """Manhattan distance between two cells."""
    return abs(tables.columns[a] - tables.columns[b]) + abs(tables.rows[a] - tables.rows[b])
