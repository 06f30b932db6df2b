"""Ways between cells where nothing blocks and every step costs the same."""

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Action

Position = tuple[int, int]


def distance(a: Position, b: Position) -> int:
    """Steps from one position to another."""
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


TOWARDS = (
    (Action.LEFT, Action.LEFT, Action.LEFT),
    (Action.UP, Action.WAIT, Action.DOWN),
    (Action.RIGHT, Action.RIGHT, Action.RIGHT),
)
"""The action towards a target, by the signs of its distance along x and y, each plus 1: along the row first."""
TOWARDS_ARRAY = np.array(TOWARDS, np.int64)


def towards(a: Position, b: Position) -> Action:
    """The first action of a shortest way from `a` to `b`: along the row first; WAIT if there is nowhere to go."""
    return TOWARDS[(b[0] > a[0]) - (b[0] < a[0]) + 1][(b[1] > a[1]) - (b[1] < a[1]) + 1]


def towards_batch(a: npt.NDArray[np.int64], b: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """The same for positions int64[N, 2]: actions, int64[N]."""
    signs = np.sign(b - a) + 1
    return TOWARDS_ARRAY[signs[:, 0], signs[:, 1]]


def route(a: Position, b: Position) -> list[Action]:
    """All actions of that way."""
    sideways = [towards(a, (b[0], a[1]))] * abs(b[0] - a[0])
    return sideways + [towards((b[0], a[1]), b)] * abs(b[1] - a[1])
