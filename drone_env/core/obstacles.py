"""Collisions: what a move runs into."""

from drone_env.core.actions import Event
from drone_env.core.tables import NOWHERE, Buffer, Tables

WALL = int(Event.WALL)
BLOCKED = int(Event.BLOCKED)
NONE = int(Event.NONE)


def collision(tables: Tables, grid: Buffer, to: int) -> int:
    """`Event.WALL` or `Event.BLOCKED` if the drone cannot enter the cell `to`, else `Event.NONE`."""
    if to == NOWHERE:
        return WALL
    if tables.any_impassable and tables.impassable[grid[to]]:
        return BLOCKED
    return NONE
