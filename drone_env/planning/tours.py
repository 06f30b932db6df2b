"""The shortest tours of many maps at once, compiled."""

from typing import Any

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core.compile_cache import compiled_once
from drone_env.planning.held_karp import held_karp

register_jitable(held_karp)


@compiled_once(nogil=True)
def plan_kernel(starts: Any, parcels: Any, budgets: Any, orders: Any) -> None:
    """Write the order of each map's tour into `orders`, -1 behind its end."""
    n = parcels.shape[1]
    first = np.zeros(n, np.int64)
    legs = np.zeros((n, n), np.int64)
    lengths = np.zeros((1 << n, n), np.int64)
    for k in range(len(parcels)):
        for i in range(n):
            first[i] = abs(parcels[k, i, 0] - starts[k, 0]) + abs(parcels[k, i, 1] - starts[k, 1])
            for j in range(n):
                legs[i, j] = abs(parcels[k, i, 0] - parcels[k, j, 0]) + abs(parcels[k, i, 1] - parcels[k, j, 1])
        visited = held_karp(first, legs, n, budgets[k], lengths, orders[k])
        for i in range(visited, n):
            orders[k, i] = -1


def plan_tours(
    starts: npt.NDArray[np.int64], parcels: npt.NDArray[np.int64], budgets: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """The shortest tours of N maps with D parcels each.

    Args:
        starts: int64[N, 2], (x, y) of the drones.
        parcels: int64[N, D, 2], (x, y) of the parcels.
        budgets: int64[N], steps that may be taken.

    Returns:
        int64[N, D]: the numbers of the parcels in the order in which to visit them, -1 for those beyond the budget.
    """
    orders = np.zeros(parcels.shape[:2], np.int64)
    plan_kernel(starts, parcels, budgets, orders)
    return orders
