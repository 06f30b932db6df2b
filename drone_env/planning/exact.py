"""The exact value of every state: dynamic programming backwards over (steps, battery, delivered set, cell).

It covers every mechanic of `TaskConfig`; where `legs` covers a task too, that takes a hundredth of the time and less.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core import compiled
from drone_env.core.actions import FLYING, N_ACTIONS
from drone_env.core.compile_cache import compiled_once
from drone_env.core.drone import units_left
from drone_env.core.episode import Episode
from drone_env.core.rules import outcome_of
from drone_env.planning.map_graph import MapGraph, map_graph, require_memory
from drone_env.planning.solver import Solver, ranked_scores


class Values(NamedTuple):
    """The values of all states that can come of one with T steps left, as the kernel sees them."""

    graph: MapGraph
    ends: Any
    """[deliveries + 1, capacity + 1, max_steps + 1], the rank of the score of each end."""
    lowest: Any
    """int64[T + 1], the lowest battery that can be left after each step from `first_step` on, at least 1."""
    starts: Any
    """int64[T + 1], where the ranks of each step start."""
    first_step: int
    """Steps taken when the planning starts."""
    ranks: Any
    """[starts[-1]], the rank of each value: place by place, after battery, after step."""


def rank_after(values: Values, t: int, battery: int, place: int, action: int) -> Any:
    """The rank of the highest score that can be reached after an action, `t` steps after `first_step`."""
    tables, leads_to, drain, done = values.graph
    to, steps = int(leads_to[place, action]), values.first_step + t + 1
    left = units_left(tables, battery, int(drain[place, action]))
    deliveries_done = int(done[to // tables.cells])
    if outcome_of(tables, deliveries_done, left, steps) != FLYING:
        return np.int64(values.ends[deliveries_done, left, steps])
    return np.int64(values.ranks[values.starts[t + 1] + (left - values.lowest[t + 1]) * len(leads_to) + to])


register_jitable(forceinline=True, **compiled.OPTIONS)(rank_after)


@compiled_once(nogil=True, **compiled.OPTIONS)
def value_kernel(values: Values) -> None:
    """Fill in the ranks from the last step backwards."""
    leads_to, lowest, starts = values.graph.leads_to, values.lowest, values.starts
    places = len(leads_to)
    for t in range(len(starts) - 2, -1, -1):
        size = (starts[t + 1] - starts[t]) // places
        for j in range(size):
            for place in range(places):
                if leads_to[place, 0] < 0:
                    continue
                best = 0
                for action in range(N_ACTIONS):
                    best = max(best, rank_after(values, t, lowest[t] + j, place, action))
                values.ranks[starts[t] + j * places + place] = best


class ExactSolver(Solver):
    """The values of every state, worked out for each state. It covers every task.

    Args:
        episode: In flight; it is left as it is. Everything that can still become of it is solved.

    Raises:
        EpisodeError: if the episode has not begun, or has ended.
        TooLargeError: if that would take more memory than `map_graph.MAX_BYTES`.
    """

    def __init__(self, episode: Episode) -> None:
        super().__init__(episode)
        task = episode.task
        places = task.width * task.height << len(self._waiting)
        require_memory("the exact values", task, 30 * places)
        self._scores, ends = ranked_scores(task)
        lowest, sizes = self._battery_ranges
        starts = np.concatenate([[0], np.cumsum(sizes)]) * places
        require_memory("the exact values", task, int(starts[-1]) * ends.itemsize)
        ranks = np.zeros(int(starts[-1]), ends.dtype)
        self._values = Values(map_graph(episode), ends, lowest, starts, episode.steps, ranks)
        value_kernel(self._values)

    @property
    def nbytes(self) -> int:
        """Memory that the values take."""
        return self._values.ranks.nbytes

    def _values_in_flight(self, states: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        graph, _, lowest, starts, _, ranks = self._values
        delivered, cell, battery, left = states.T
        t = len(starts) - 1 - left
        place = delivered * graph.tables.cells + cell
        return self._scores[ranks[starts[t] + (battery - lowest[t]) * len(graph.leads_to) + place]]
