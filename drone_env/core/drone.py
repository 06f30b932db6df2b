"""The drone itself: where it can fly and what that costs the battery."""

from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.rules import BATTERY, CELL, UNDER, Buffer, Rules

DRONE = int(Cell.DRONE)
PAD = int(Cell.PAD)
WAIT = int(Action.WAIT)


def place(grid: Buffer, row: Buffer, cell: int) -> None:
    """Put the drone on `cell` and uncover the cell that it leaves."""
    grid[row[CELL]] = row[UNDER]
    row[CELL] = cell
    row[UNDER] = grid[cell]
    grid[cell] = DRONE


def use_battery(rules: Rules, row: Buffer, action: int) -> None:
    """Drain by the kind of cell below the drone, never under 0; WAIT on a pad charges instead, never over capacity."""
    under = row[UNDER]
    if action == WAIT and under == PAD and rules.charge_rate > 0:
        row[BATTERY] = min(rules.capacity, row[BATTERY] + rules.charge_rate)
    else:
        row[BATTERY] = max(0, row[BATTERY] - rules.drain[under])


def distance(rules: Rules, a: int, b: int) -> int:
    """Manhattan distance between two cells."""
    return abs(rules.columns[a] - rules.columns[b]) + abs(rules.lines[a] - rules.lines[b])
