"""Collisions: what a move runs into, and what the drone is above."""

from drone_env.core.actions import N_ACTIONS, Event
from drone_env.core.rules import NOWHERE, Buffer, Rules

WALL = int(Event.WALL)
BLOCKED = int(Event.BLOCKED)
NONE = int(Event.NONE)


def collision(rules: Rules, grid: Buffer, to: int) -> int:
    """`Event.WALL` or `Event.BLOCKED` if the drone cannot enter the cell `to`, else `Event.NONE`."""
    if to == NOWHERE:
        return WALL
    if rules.any_impassable and rules.impassable[grid[to]]:
        return BLOCKED
    return NONE


def flight_event(rules: Rules, under: int, action: int) -> int:
    """The event of an action that nothing stopped: by the terrain below the drone, else waiting or flying."""
    return rules.flight_event[under * N_ACTIONS + action]
