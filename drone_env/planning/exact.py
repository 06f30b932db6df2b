"""The exact value of every state: dynamic programming backwards over (steps, battery, delivered set, cell).

Bellman, "Dynamic Programming", 1957. The graded score is paid once, at the end, and is not discounted, so the value of
a state is the highest score that can still be reached from it: V*(s) = max over a of V*(step(s, a)). Only maxima are
taken, never sums, so values equal scores to the last bit. It covers every mechanic of `TaskConfig`.

A value is kept as the rank of a score among all scores that the task knows, which takes two bytes instead of eight.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core import compiled
from drone_env.core.actions import FLYING, N_ACTIONS, Action, check_action
from drone_env.core.cells import Cell
from drone_env.core.compile_cache import compiled_once
from drone_env.core.drone import units_left
from drone_env.core.episode import Episode
from drone_env.core.rollout import rollout
from drone_env.core.rules import outcome_of
from drone_env.core.score import score_of
from drone_env.core.tables import Tables, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.errors import EpisodeError
from drone_env.planning.map_graph import MapGraph, battery_ranges, map_graph, require_memory, waiting_parcels

ANOTHER = "this episode cannot have come from the one that was solved: make a solver of its own"


@compiled_once(nogil=True, **compiled.OPTIONS)
def score_kernel(tables: Tables, scores: Any) -> None:
    """Write the score of every end into float64[deliveries + 1, capacity + 1, max_steps + 1]."""
    for deliveries in range(scores.shape[0]):
        for battery in range(scores.shape[1]):
            for steps in range(scores.shape[2]):
                scores[deliveries, battery, steps] = score_of(tables, deliveries, battery, steps)


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


@lru_cache(maxsize=16)
def ranked_scores(task: TaskConfig) -> tuple[npt.NDArray[np.float64], npt.NDArray[Any]]:
    """All scores of a task in rising order, and in it the rank of each end.

    The ranks are an array [deliveries + 1, capacity + 1, max_steps + 1].
    """
    scores = np.zeros((task.deliveries + 1, task.battery_capacity + 1, task.max_steps + 1))
    score_kernel(tabulate(task), scores)
    unique, ranks = np.unique(scores, return_inverse=True)
    return unique, np.reshape(ranks, scores.shape).astype(np.uint16 if len(unique) <= 1 << 16 else np.uint32)


class ExactSolver:
    """V*, Q*, optimal actions and regrets of every state that an episode can reach.

    Args:
        episode: In flight; it is left as it is. Everything that can still become of it is solved.

    Raises:
        EpisodeError: if the episode has not begun, or has ended.
        TooLargeError: if that would take more memory than `map_graph.MAX_BYTES`.
    """

    def __init__(self, episode: Episode) -> None:
        if episode.ended:
            raise EpisodeError("the episode has ended: there is nothing left to solve")
        task = episode.task
        self._start, self._unflown = episode.copy(), _unflown(episode)
        self._waiting = waiting_parcels(episode)
        places = task.width * task.height << len(self._waiting)
        ends = (task.deliveries + 1) * (task.battery_capacity + 1) * (task.max_steps + 1)
        require_memory("the exact values", task, 12 * ends + 30 * places)
        graph = map_graph(episode)
        lowest, sizes = battery_ranges(episode)
        starts = np.concatenate([[0], np.cumsum(sizes)]) * places
        self._scores, ranked = ranked_scores(task)
        require_memory("the exact values", task, int(starts[-1]) * ranked.itemsize)
        ranks = np.zeros(int(starts[-1]), ranked.dtype)
        self._values = Values(graph, ranked, lowest, starts, episode.steps, ranks)
        value_kernel(self._values)

    @property
    def nbytes(self) -> int:
        """Memory that the values take."""
        return self._values.ranks.nbytes

    def q_values(self, episode: Episode) -> npt.NDArray[np.float64]:
        """Q*, float64[5]: the highest score that can still be reached after each action.

        Raises:
            EpisodeError: if the episode has ended, or cannot have come from the one that was solved.
        """
        place, t = self._locate(episode), episode.steps - self._values.first_step
        after = [rank_after(self._values, t, episode.battery_units, place, action) for action in range(N_ACTIONS)]
        return self._scores[after]

    def value(self, episode: Episode) -> float:
        """V*: the highest score that can still be reached; after the end, the score.

        Raises:
            EpisodeError: if the episode cannot have come from the one that was solved.
        """
        return episode.score if episode.ended else float(self.q_values(episode).max())

    def optimal_actions(self, episode: Episode) -> tuple[Action, ...]:
        """All actions after which the highest score can still be reached; raises as `q_values`."""
        values = self.q_values(episode)
        return tuple(Action(int(action)) for action in np.flatnonzero(values == values.max()))

    def regret(self, episode: Episode, action: int) -> float:
        """V*(s) - Q*(s, a): what an action gives away for good, in score.

        Raises:
            InvalidValueError: if the action is not an integer from 0 to 4.
            EpisodeError: as `q_values`.
        """
        number = check_action(action)
        values = self.q_values(episode)
        return float(values.max() - values[number])

    def best_actions(self) -> list[Action]:
        """One best sequence of actions, from where the solved episode stood to its end.

        Of equally good actions the lowest number, so it is the same in every run.
        """
        flight = self._start.copy()
        rollout(flight, lambda _: self.optimal_actions(flight)[0])
        return [step.action for step in flight.path[len(self._start.actions) :]]

    def _locate(self, episode: Episode) -> int:
        """The place of an episode."""
        if episode.ended:
            raise EpisodeError("the episode has ended: there is no action left to value")
        if (episode.task, episode.seed) != (self._start.task, self._start.seed):
            raise EpisodeError(ANOTHER)
        graph, _, lowest, starts, first_step, _ = self._values
        waiting, t = waiting_parcels(episode), episode.steps - first_step
        delivered = sum(1 << k for k, parcel in enumerate(self._waiting) if parcel not in waiting)
        place = delivered * graph.tables.cells + episode.cell
        possible = (
            t >= 0
            and np.array_equal(_unflown(episode), self._unflown)
            and set(waiting) <= set(self._waiting)
            and graph.leads_to[place, 0] >= 0
            and 0 <= episode.battery_units - lowest[t] < (starts[t + 1] - starts[t]) // len(graph.leads_to)
        )
        if not possible:
            raise EpisodeError(ANOTHER)
        return place


def _unflown(episode: Episode) -> npt.NDArray[np.int64]:
    """What no flight changes: the map with neither drone nor deliveries, and where each parcel lies or lay."""
    grid = episode.grid()
    x, y = episode.position
    grid[y, x] = episode.under
    parcels = [(x, y) for x, y, _ in episode.parcels]
    for x, y in parcels:
        grid[y, x] = Cell.DELIVERY
    return np.append(grid, parcels)
