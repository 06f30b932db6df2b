"""The exact value of every state: dynamic programming backwards over (steps, battery, delivered set, cell).

Bellman, "Dynamic Programming", 1957. The graded score is paid once, at the end, and is not discounted, so the value of
a state is the highest score that can still be reached from it: V*(s) = max over a of V*(step(s, a)). Only maxima are
taken, never sums, so values equal scores to the last bit. It covers every mechanic of `TaskConfig`.

A value is kept as the rank of a score among all scores that the task knows, which takes two bytes instead of eight.
"""

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.core import compiled
from drone_env.core.actions import N_ACTIONS, Action, Outcome, check_action
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
from drone_env.planning.map_graph import battery_ranges, drain_range, map_graph, require_memory, waiting_parcels

FLYING = int(Outcome.FLYING)
ANOTHER = "this episode cannot have come from the one that was solved: make a solver of its own"


@compiled_once(nogil=True, **compiled.OPTIONS)
def score_kernel(tables: Tables, scores: Any) -> None:
    """Write the score of every end into float64[deliveries + 1, capacity + 1, max_steps + 1]."""
    for deliveries in range(scores.shape[0]):
        for battery in range(scores.shape[1]):
            for steps in range(scores.shape[2]):
                scores[deliveries, battery, steps] = score_of(
                    deliveries,
                    tables.deliveries,
                    battery,
                    tables.capacity,
                    steps,
                    tables.max_steps,
                    tables.efficiency_needs_all,
                )


@compiled_once(nogil=True, **compiled.OPTIONS)
def value_kernel(
    tables: Tables,
    leads_to: Any,
    drain: Any,
    done: Any,
    ranks: Any,
    lowest: Any,
    starts: Any,
    first_step: int,
    values: Any,
) -> None:
    """Fill `values` from the last step backwards.

    Args:
        tables: The task's tables.
        leads_to: int32[places, 5], see `MapGraph`.
        drain: int16[places, 5], see `MapGraph`.
        done: int64[2^n], parcels delivered in all for each delivered set.
        ranks: [deliveries + 1, capacity + 1, max_steps + 1], the rank of the score of each end.
        lowest: int64[T + 1], the lowest battery that can be left after each step from `first_step` on, at least 1.
        starts: int64[T + 1], where the values of each step start.
        first_step: Steps taken when the planning starts.
        values: [starts[-1]], receives the ranks; place by place, after battery, after step.
    """
    places = len(leads_to)
    for t in range(len(starts) - 2, -1, -1):
        steps = first_step + t + 1
        size = (starts[t + 1] - starts[t]) // places
        for j in range(size):
            for place in range(places):
                if leads_to[place, 0] < 0:
                    continue
                best = 0
                for action in range(N_ACTIONS):
                    to = leads_to[place, action]
                    battery = units_left(tables, lowest[t] + j, drain[place, action])
                    deliveries = done[to // tables.cells]
                    if outcome_of(tables, deliveries, battery, steps) != FLYING:
                        rank = np.int64(ranks[deliveries, battery, steps])
                    else:
                        rank = np.int64(values[starts[t + 1] + (battery - lowest[t + 1]) * places + to])
                    best = max(best, rank)
                values[starts[t] + j * places + place] = best


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
    """V*, Q*, optimal actions and regrets of every state that an episode can come to.

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
        self._places = task.width * task.height << len(self._waiting)
        ends = (task.deliveries + 1) * (task.battery_capacity + 1) * (task.max_steps + 1)
        require_memory("the exact values", task, 12 * ends + 30 * self._places)
        self._graph = map_graph(episode)
        steps_left = task.max_steps - episode.steps
        self._lowest, sizes = battery_ranges(episode.battery_units, *drain_range(task), task, steps_left)
        self._starts = np.concatenate([[0], np.cumsum(sizes)]) * self._places
        self._scores, self._ranks = ranked_scores(task)
        require_memory("the exact values", task, int(self._starts[-1]) * self._ranks.itemsize)
        self._values = np.zeros(int(self._starts[-1]), self._ranks.dtype)
        value_kernel(*self._graph, self._ranks, self._lowest, self._starts, episode.steps, self._values)

    @property
    def nbytes(self) -> int:
        """Memory that the values take."""
        return self._values.nbytes

    def q_values(self, episode: Episode) -> npt.NDArray[np.float64]:
        """Q*, float64[5]: the highest score that can still be reached after each action.

        Raises:
            EpisodeError: if the episode has ended, or cannot have come from the one that was solved.
        """
        tables, leads_to, drain, done = self._graph
        place, steps, battery = self._locate(episode), episode.steps, episode.battery_units
        t = steps - self._start.steps
        ranks = np.zeros(N_ACTIONS, np.int64)
        for action in range(N_ACTIONS):
            to = int(leads_to[place, action])
            left = units_left(tables, battery, int(drain[place, action]))
            deliveries = int(done[to // tables.cells])
            if outcome_of(tables, deliveries, left, steps + 1) != FLYING:
                ranks[action] = self._ranks[deliveries, left, steps + 1]
            else:
                index = int(self._starts[t + 1]) + (left - int(self._lowest[t + 1])) * self._places + to
                ranks[action] = self._values[index]
        return self._scores[ranks]

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
        flight = rollout(self._start.copy(), lambda flight: self.optimal_actions(flight)[0])
        return [step.action for step in flight.path[len(self._start.actions) :]]

    def _locate(self, episode: Episode) -> int:
        """The place of an episode."""
        if episode.ended:
            raise EpisodeError("the episode has ended: there is no action left to value")
        if (episode.task, episode.seed) != (self._start.task, self._start.seed):
            raise EpisodeError(ANOTHER)
        waiting, t = waiting_parcels(episode), episode.steps - self._start.steps
        delivered = sum(1 << k for k, parcel in enumerate(self._waiting) if parcel not in waiting)
        place = delivered * self._graph.tables.cells + episode.cell
        possible = (
            t >= 0
            and np.array_equal(_unflown(episode), self._unflown)
            and set(waiting) <= set(self._waiting)
            and int(self._graph.leads_to[place, 0]) >= 0
            and 0 <= episode.battery_units - self._lowest[t] < (self._starts[t + 1] - self._starts[t]) // self._places
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
