"""The shortest tours of many maps at once, compiled."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core.actions import Action
from drone_env.core.compile_cache import compiled_once
from drone_env.planning.held_karp import held_karp

UP, DOWN, LEFT, RIGHT = (int(action) for action in (Action.UP, Action.DOWN, Action.LEFT, Action.RIGHT))
register_jitable(held_karp)


@compiled_once(nogil=True)
def plan_kernel(starts: Any, parcels: Any, budgets: Any, plans: Any) -> None:
    """Write the actions of each map's tour into `plans`, whose rest stays as it is: along rows first, as `route`."""
    n = parcels.shape[1]
    first, order = np.zeros(n, np.int64), np.zeros(n, np.int64)
    legs = np.zeros((n, n), np.int64)
    lengths = np.zeros((1 << n, n), np.int64)
    for k in range(len(parcels)):
        x, y, t = starts[k, 0], starts[k, 1], 0
        for i in range(n):
            first[i] = abs(parcels[k, i, 0] - x) + abs(parcels[k, i, 1] - y)
            for j in range(n):
                legs[i, j] = abs(parcels[k, i, 0] - parcels[k, j, 0]) + abs(parcels[k, i, 1] - parcels[k, j, 1])
        visited = held_karp(first, legs, n, budgets[k], lengths, order)
        for i in order[:visited]:
            across, down = parcels[k, i, 0] - x, parcels[k, i, 1] - y
            plans[k, t : t + abs(across)] = RIGHT if across > 0 else LEFT
            t += abs(across)
            plans[k, t : t + abs(down)] = DOWN if down > 0 else UP
            t += abs(down)
            x, y = x + across, y + down


def plan_tours(
    starts: npt.NDArray[np.int64], parcels: npt.NDArray[np.int64], budgets: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """The flights over the shortest tours of N maps with D parcels each.

    Args:
        starts: int64[N, 2], (x, y) of the drones.
        parcels: int64[N, D, 2], (x, y) of the parcels.
        budgets: int64[N], steps that may be taken: the parcels beyond are left out.

    Returns:
        int64[N, highest budget]: the actions, WAIT behind the end of a tour.
    """
    plans = np.full((len(starts), budgets.max()), Action.WAIT, np.int64)
    plan_kernel(starts, parcels, budgets, plans)
    return plans


@compiled_once(nogil=True)
def tour_kernel(first: Any, legs: Any, budget: int, lengths: Any, order: Any) -> int:
    """`held_karp`, compiled."""
    return held_karp(first, legs, len(first), budget, lengths, order)


def shortest_over(first: Sequence[int], legs: Sequence[Sequence[int]], budget: int) -> tuple[int, int]:
    """How many of n places a budget allows to visit, and the length of the shortest path over them all.

    Args:
        first: The way from the start to each place, [n].
        legs: The way from place to place, [n][n].
        budget: What may be spent, below `UNREACHED`.

    Returns:
        The length is `UNREACHED` where the budget does not allow all.
    """
    n = len(first)
    lengths, order = np.zeros((1 << n, n), np.int64), np.zeros(n, np.int64)
    visited = tour_kernel(np.array(first, np.int64), np.array(legs, np.int64), budget, lengths, order)
    return int(visited), int(lengths[-1].min())
