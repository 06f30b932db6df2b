"""Collisions: what a move runs into, and what the drone is above."""

from drone_env.core.actions import N_ACTIONS, Event
from drone_env.core.rules import CELL, UNDER, Buffer, Rules

WALL = int(Event.WALL)
BLOCKED = int(Event.BLOCKED)
NONE = int(Event.NONE)
STEP = int(Event.STEP)


def collision(rules: Rules, grid: Buffer, row: Buffer, action: int) -> int:
    """`Event.WALL` or `Event.BLOCKED` if `action` cannot be flown from here, else `Event.NONE`."""
    to = rules.moves[row[CELL] * N_ACTIONS + action]
    if to < 0:
        return WALL
    if rules.passable[grid[to]] == 0:
        return BLOCKED
    return NONE


def terrain_event(rules: Rules, row: Buffer) -> int:
    """The event of the terrain below the drone; `Event.STEP` where there is none."""
    return rules.terrain_event[row[UNDER]]
