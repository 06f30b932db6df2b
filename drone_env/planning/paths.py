"""Ways between cells where nothing blocks and every step costs the same."""

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import Action

Position = tuple[int, int]

TOWARDS = np.array(
    [
        [Action.LEFT, Action.LEFT, Action.LEFT],
        [Action.UP, Action.WAIT, Action.DOWN],
        [Action.RIGHT, Action.RIGHT, Action.RIGHT],
    ],
    np.int64,
)
"""The action towards a target, by the signs of its distance along x and y, each plus 1: along the row first."""


def distance(a: Position, b: Position) -> int:
    """Steps from one position to another."""
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


def towards(a: npt.NDArray[np.int64], b: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """The first actions, int64[N], of shortest ways between positions int64[N, 2]; WAIT at the goal."""
    signs = np.sign(b - a) + 1
    return TOWARDS[signs[:, 0], signs[:, 1]]


def route(a: Position, b: Position) -> list[Action]:
    """All actions of a shortest way: along the row first."""
    sideways = [Action.RIGHT if b[0] > a[0] else Action.LEFT] * abs(b[0] - a[0])
    return sideways + [Action.DOWN if b[1] > a[1] else Action.UP] * abs(b[1] - a[1])
