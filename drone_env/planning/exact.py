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
from drone_env.core.actions import N_ACTIONS, Action, Outcome
from drone_env.core.compile_cache import compiled_once
from drone_env.core.drone import units_left
from drone_env.core.episode import ALLOWED_ACTIONS, Episode
from drone_env.core.rules import outcome_of
from drone_env.core.score import score_of
from drone_env.core.tables import BATTERY, CELL, DELIVERED_FLAG, PARCELS, STEPS, Tables, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.errors import EpisodeError, InvalidValueError
from drone_env.planning.map_graph import (
    battery_ranges,
    delivered_set,
    done_counts,
    drain_range,
    map_graph,
    require_memory,
    state_arrays,
)

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
        self._start = episode.get_state()
        self._task = task
        self._grid, state, self._parcels = state_arrays(episode)
        self._first_step, battery = int(state[STEPS]), int(state[BATTERY])
        self._places = len(self._grid) << len(self._parcels)
        ends = (task.deliveries + 1) * (task.battery_capacity + 1) * (task.max_steps + 1)
        require_memory("the exact values", task, 12 * ends + 30 * self._places)
        graph = map_graph(episode)
        lowest, sizes = battery_ranges(battery, *drain_range(task), task, task.max_steps - self._first_step)
        self._lowest = lowest
        self._starts = np.concatenate([[0], np.cumsum(sizes)]) * self._places
        self._scores, ranks = ranked_scores(task)
        require_memory("the exact values", task, int(self._starts[-1]) * ranks.itemsize)
        self._done = done_counts(task, self._parcels)
        self._leads_to, self._drain, self._ranks = graph.leads_to, graph.drain, ranks
        self._values = np.zeros(int(self._starts[-1]), ranks.dtype)
        value_kernel(
            graph.tables,
            graph.leads_to,
            graph.drain,
            self._done,
            ranks,
            lowest,
            self._starts,
            self._first_step,
            self._values,
        )
        self._tables = graph.tables

    @property
    def nbytes(self) -> int:
        """Memory that the values take."""
        return self._values.nbytes

    def q_values(self, episode: Episode) -> npt.NDArray[np.float64]:
        """Q*, float64[5]: the highest score that can still be reached after each action.

        Raises:
            EpisodeError: if the episode has ended, or cannot have come from the one that was solved.
        """
        place, steps, battery = self._locate(episode)
        t = steps - self._first_step
        ranks = np.zeros(N_ACTIONS, np.int64)
        for action in range(N_ACTIONS):
            to = int(self._leads_to[place, action])
            left = units_left(self._tables, battery, int(self._drain[place, action]))
            deliveries = int(self._done[to // self._tables.cells])
            if outcome_of(self._tables, deliveries, left, steps + 1) != FLYING:
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
        if isinstance(action, bool) or action not in range(N_ACTIONS):
            raise InvalidValueError(f"action must be one of {ALLOWED_ACTIONS}; got {action!r}")
        values = self.q_values(episode)
        return float(values.max() - values[action])

    def best_actions(self) -> list[Action]:
        """One best sequence of actions, from where the solved episode stood to its end.

        Of equally good actions the lowest number, so it is the same in every run.
        """
        flight = Episode(self._task, self._start.reward_profile)
        flight.set_state(self._start)
        actions: list[Action] = []
        while not flight.ended:
            actions.append(self.optimal_actions(flight)[0])
            flight.step(actions[-1])
        return actions

    def _locate(self, episode: Episode) -> tuple[int, int, int]:
        """(place, steps, battery) of an episode."""
        if episode.ended:
            raise EpisodeError("the episode has ended: there is no action left to value")
        grid, state, _ = state_arrays(episode)
        if not self._same_map(episode, grid, state):
            raise EpisodeError(ANOTHER)
        t, battery = int(state[STEPS]) - self._first_step, int(state[BATTERY])
        place = delivered_set(state, self._parcels) * self._tables.cells + int(state[CELL])
        possible = (
            t >= 0
            and np.all(np.delete(state, self._parcels)[PARCELS:] >= DELIVERED_FLAG)
            and int(self._leads_to[place, 0]) >= 0
            and self._lowest[t] <= battery < self._lowest[t] + (self._starts[t + 1] - self._starts[t]) // self._places
        )
        if not possible:
            raise EpisodeError(ANOTHER)
        return place, int(state[STEPS]), battery

    def _same_map(self, episode: Episode, grid: npt.NDArray[np.uint8], state: npt.NDArray[np.uint16]) -> bool:
        """Whether an episode, with this grid (which is overwritten) and state, is of the map that was solved."""
        if (episode.task, episode.seed) != (self._task, self._start.seed):
            return False
        parcels = state[PARCELS:] % DELIVERED_FLAG
        grid[parcels] = self._grid[parcels]  # whether delivered or not
        start = np.frombuffer(self._start.numbers, np.uint16)
        return np.array_equal(parcels, start[PARCELS:] % DELIVERED_FLAG) and np.array_equal(grid, self._grid)
