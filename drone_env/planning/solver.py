"""The value of every decision of a map: what its solvers have in common.

The graded score is paid once, at the end, and is not discounted, so the value of a state is the highest score that can
still be reached from it: V*(s) = max over a of Q*(s, a), and Q*(s, a) = V*(step(s, a)) (Bellman, "Dynamic
Programming", 1957). Only maxima are taken, never sums, so values equal scores to the last bit.

A solver keeps a value as the rank of a score among all scores that the task knows, which takes two bytes, not eight.
"""

from abc import ABC, abstractmethod
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.core import compiled
from drone_env.core.actions import Action, check_action
from drone_env.core.cells import Cell
from drone_env.core.compile_cache import compiled_once
from drone_env.core.episode import Episode
from drone_env.core.rollout import rollout
from drone_env.core.score import score_of
from drone_env.core.tables import Tables, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.errors import EpisodeError
from drone_env.planning.map_graph import battery_ranges, require_memory, waiting_parcels

ANOTHER = "this episode cannot have come from the one that was solved: make a solver of its own"


@compiled_once(nogil=True, **compiled.OPTIONS)
def score_kernel(tables: Tables, scores: Any) -> None:
    """Write the score of every end into float64[deliveries + 1, capacity + 1, max_steps + 1]."""
    for deliveries in range(scores.shape[0]):
        for battery in range(scores.shape[1]):
            for steps in range(scores.shape[2]):
                scores[deliveries, battery, steps] = score_of(tables, deliveries, battery, steps)


@lru_cache(maxsize=16)
def ranked_scores(task: TaskConfig) -> tuple[npt.NDArray[np.float64], npt.NDArray[Any]]:
    """All scores of a task in rising order, and in it the rank of each end.

    The ranks are an array [deliveries + 1, capacity + 1, max_steps + 1], of uint16 where that is enough, else uint32.

    Raises:
        TooLargeError: if they would take more memory than `map_graph.MAX_BYTES`.
    """
    ends = (task.deliveries + 1) * (task.battery_capacity + 1) * (task.max_steps + 1)
    require_memory("the scores", task, 12 * ends)
    scores = np.zeros((task.deliveries + 1, task.battery_capacity + 1, task.max_steps + 1))
    score_kernel(tabulate(task), scores)
    unique, ranks = np.unique(scores, return_inverse=True)
    return unique, np.reshape(ranks, scores.shape).astype(np.uint16 if len(unique) <= 1 << 16 else np.uint32)


class Solver(ABC):
    """V*, Q*, optimal actions and regrets of every state that an episode can reach.

    Args:
        episode: In flight; it is left as it is. Everything that can still become of it is solved.

    Raises:
        EpisodeError: if the episode has not begun, or has ended.
    """

    def __init__(self, episode: Episode) -> None:
        if episode.ended:
            raise EpisodeError("the episode has ended: there is nothing left to solve")
        self._start = episode.copy()
        self._waiting = waiting_parcels(episode)

    @property
    @abstractmethod
    def nbytes(self) -> int:
        """Memory that the values take."""

    @abstractmethod
    def _values_after(self, episode: Episode, delivered: int) -> npt.NDArray[np.float64]:
        """float64[5], the value of where each action leads an episode that can have come from the one that was solved.

        Bit i of `delivered` stands for the i-th parcel that was waiting in that one.
        """

    def q_values(self, episode: Episode) -> npt.NDArray[np.float64]:
        """Q*, float64[5]: the highest score that can still be reached after each action.

        Raises:
            EpisodeError: if the episode has ended, or cannot have come from the one that was solved.
        """
        return self._values_after(episode, self._delivered(episode))

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
        """One best sequence of actions, from where the solved episode stood; the same in every run.

        At its end there may be nothing left but to wait.
        """
        flight = self._start.copy()
        rollout(flight, lambda _: self.optimal_actions(flight)[0])
        return [step.action for step in flight.path[len(self._start.actions) :]]

    def _delivered(self, episode: Episode) -> int:
        """Which of the parcels that waited at the start an episode in flight has delivered, bit i for the i-th."""
        if episode.ended:
            raise EpisodeError("the episode has ended: there is no action left to value")
        if (episode.task, episode.seed) != (self._start.task, self._start.seed):
            raise EpisodeError(ANOTHER)
        waiting, t = waiting_parcels(episode), episode.steps - self._start.steps
        lowest, sizes = self._battery_ranges
        possible = (
            t >= 0
            and np.array_equal(_unflown(episode), self._unflown)
            and set(waiting) <= set(self._waiting)
            and all((x, y) != episode.position or delivered for x, y, delivered in episode.parcels)
            and episode.under not in episode.task.impassable
            and 0 <= episode.battery_units - lowest[t] < sizes[t]
        )
        if not possible:
            raise EpisodeError(ANOTHER)
        return sum(1 << k for k, parcel in enumerate(self._waiting) if parcel not in waiting)

    @cached_property
    def _battery_ranges(self) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        return battery_ranges(self._start)

    @cached_property
    def _unflown(self) -> npt.NDArray[np.int64]:
        return _unflown(self._start)


def _unflown(episode: Episode) -> npt.NDArray[np.int64]:
    """What no flight changes: the map with neither drone nor deliveries, and where each parcel lies or lay."""
    grid = episode.grid()
    x, y = episode.position
    grid[y, x] = episode.under
    parcels = [(x, y) for x, y, _ in episode.parcels]
    for x, y in parcels:
        grid[y, x] = Cell.DELIVERY
    return np.append(grid, parcels)
