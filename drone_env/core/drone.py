"""The drone itself: how it moves over the grid and what that costs the battery."""

from drone_env.core.actions import N_ACTIONS
from drone_env.core.cells import Cell
from drone_env.core.rules import BATTERY, CELL, UNDER, Buffer, Rules

DRONE = int(Cell.DRONE)


def move(rules: Rules, grid: Buffer, row: Buffer, action: int) -> None:
    """Fly an action that nothing stops: uncover the cell that the drone leaves, cover the one that it reaches."""
    cell = row[CELL]
    to = rules.moves[cell * N_ACTIONS + action]
    grid[cell] = row[UNDER]
    row[UNDER] = grid[to]
    row[CELL] = to
    grid[to] = DRONE


def use_battery(rules: Rules, row: Buffer, action: int) -> None:
    """Drain, or charge, by the action and the kind of cell below the drone; never under 0 or over capacity."""
    units = row[BATTERY] - rules.drain[row[UNDER] * N_ACTIONS + action]
    row[BATTERY] = min(max(units, 0), rules.capacity)


def distance(rules: Rules, a: int, b: int) -> int:
    """Manhattan distance between two cells."""
    return abs(rules.columns[a] - rules.columns[b]) + abs(rules.lines[a] - rules.lines[b])
