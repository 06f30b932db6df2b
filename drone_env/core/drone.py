"""The drone itself: how it moves over the grid and what that costs the battery."""

from drone_env.core.actions import N_ACTIONS
from drone_env.core.cells import Cell
from drone_env.core.rules import BATTERY, CELL, UNDER, Buffer, Rules

DRONE = int(Cell.DRONE)


def move(grid: Buffer, row: Buffer, cell: int, to: int) -> int:
    """Uncover the cell that the drone leaves, cover the one that it reaches, and return the kind of that one."""
    grid[cell] = row[UNDER]
    under = grid[to]
    row[CELL] = to
    row[UNDER] = under
    grid[to] = DRONE
    return under


def use_battery(rules: Rules, row: Buffer, under: int, action: int) -> int:
    """Drain, or charge, by the action and the kind of cell below the drone; return the units left."""
    units = units_left(rules, row[BATTERY], rules.drain[under * N_ACTIONS + action])
    row[BATTERY] = units
    return units


def units_left(rules: Rules, units: int, drain: int) -> int:
    """Battery units after a drain (below zero: a charge): never under 0 or over capacity."""
    return min(max(units - drain, 0), rules.capacity)


def distance(rules: Rules, a: int, b: int) -> int:
    """Manhattan distance between two cells."""
    return abs(rules.columns[a] - rules.columns[b]) + abs(rules.lines[a] - rules.lines[b])
