"""Collisions: what a move runs into, and what the drone is above."""

from drone_env.core.actions import N_ACTIONS, Event
from drone_env.core.rules import CELL, NOWHERE, UNDER, Buffer, Rules

WALL = int(Event.WALL)
BLOCKED = int(Event.BLOCKED)
NONE = int(Event.NONE)


def collision(rules: Rules, grid: Buffer, row: Buffer, action: int) -> int:
    """`Event.WALL` or `Event.BLOCKED` if `action` cannot be flown from here, else `Event.NONE`."""
    to = rules.moves[row[CELL] * N_ACTIONS + action]
    if to == NOWHERE:
        return WALL
    if rules.passable[grid[to]] == 0:
        return BLOCKED
    return NONE


def flight_event(rules: Rules, row: Buffer, action: int) -> int:
    """The event of an action that nothing stopped: by the terrain below the drone, else waiting or flying."""
    return rules.flight_event[row[UNDER] * N_ACTIONS + action]
