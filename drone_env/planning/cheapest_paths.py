"""The cheapest ways over many maps at once, compiled."""

from typing import Any

import numba  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core import compiled
from drone_env.core.compile_cache import cached_on_disk
from drone_env.core.rules import Rules, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.planning.cheapest_path import cheapest_action

register_jitable(**compiled.OPTIONS)(cheapest_action)


def cheapest_kernel(rules: Rules, grids: Any, starts: Any, costs: Any, first: Any, actions: Any) -> None:
    """Write the action of each map."""
    for i in range(len(grids)):
        actions[i] = cheapest_action(rules, grids[i], starts[i], costs, first)


with cached_on_disk():
    cheapest_kernel = numba.njit(nogil=True, cache=True, **compiled.OPTIONS)(cheapest_kernel)


def cheapest_actions(
    task: TaskConfig, grids: npt.NDArray[np.uint8], starts: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """`cheapest_action` on N maps.

    Args:
        task: The task.
        grids: uint8[N, height, width], as the drones see them.
        starts: int64[N, 2], (x, y) of the drones.

    Returns:
        int64[N], the actions.
    """
    rules = tabulate(task)
    actions = np.zeros(len(grids), np.int64)
    cells = starts[:, 1] * task.width + starts[:, 0]
    costs, first = np.zeros((2, rules.cells), np.int64)
    cheapest_kernel(rules, np.reshape(grids, (len(grids), rules.cells)), cells, costs, first, actions)
    return actions
