"""Actions, events and outcomes."""

import operator
from enum import IntEnum
from typing import Any

from drone_env.errors import InvalidValueError


class Action(IntEnum):
    """The five actions. Rows grow downwards, so UP is y - 1."""

    UP = 0
    DOWN = 1
    LEFT = 2
    RIGHT = 3
    WAIT = 4


ACTION_OFFSETS: dict[Action, tuple[int, int]] = {
    Action.UP: (0, -1),
    Action.DOWN: (0, 1),
    Action.LEFT: (-1, 0),
    Action.RIGHT: (1, 0),
    Action.WAIT: (0, 0),
}
N_ACTIONS = len(Action)
WAIT = int(Action.WAIT)  # compiled code takes plain integers
ALLOWED_ACTIONS = ", ".join(f"{int(action)} {action.name}" for action in Action)


def integer(value: Any) -> int | None:
    """An `int` from any integer type, or None if the value is not an integer. Booleans are not integers here."""
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None


def check_action(action: object) -> int:
    """Convert an action to an `int`.

    Raises:
        InvalidValueError: if it is not an integer from 0 to 4.
    """
    number = integer(action)
    if number is None or not 0 <= number < N_ACTIONS:
        raise InvalidValueError(f"action must be one of {ALLOWED_ACTIONS}; got {action!r}")
    return number


class Event(IntEnum):
    """The event of a step: the first in this order whose condition is true."""

    DELIVERY = 0
    BATTERY_DEAD = 1
    WALL = 2
    BLOCKED = 3
    OBSTACLE = 4
    BUILDING = 5
    TREE = 6
    WAIT = 7
    STEP = 8
    NONE = 9
    """No step yet."""


N_EVENTS = len(Event)


class Outcome(IntEnum):
    """The outcome of an episode. All but FLYING end it, and are part of the task (`terminated`)."""

    FLYING = 0
    DELIVERED = 1
    BATTERY_DEAD = 2
    OUT_OF_STEPS = 3


FLYING = int(Outcome.FLYING)
"""A plain integer, because compiled code cannot use enum members."""


MESSAGES = {
    Event.NONE: "Ready for take-off: {total} to deliver.",
    Event.DELIVERY: "Delivered: {done} of {total}.",
    Event.BATTERY_DEAD: "The battery is empty: {done} of {total} delivered.",
    Event.WALL: "Bumped into the edge of the city.",
    Event.BLOCKED: "The way is blocked.",
    Event.OBSTACLE: "Above an obstacle.",
    Event.BUILDING: "Above a building.",
    Event.TREE: "Above a tree.",
    Event.WAIT: "Waiting.",
    Event.STEP: "On the way.",
}
"""The last event, in words."""

ENDINGS = {
    Outcome.FLYING: "",
    Outcome.DELIVERED: " Mission accomplished.",
    Outcome.BATTERY_DEAD: " The mission is over.",
    Outcome.OUT_OF_STEPS: " Out of steps: the mission is over.",
}
"""Added to the message at the end."""
