"""Exact values of all states and actions of a map: the base class of solvers, and the solver that covers every task.

The graded score is paid once, at the end, without discount. So the value of a state is the highest score that can still
be reached: V*(s) = max over a of Q*(s, a), and Q*(s, a) = V*(step(s, a)) (Bellman, "Dynamic Programming", 1957). There
are only maxima, no sums, so values equal scores to the last bit.

`LegSolver` stores the rank of a score among all scores of the task: two bytes instead of eight.
"""

from abc import ABC, abstractmethod
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import FLYING, N_ACTIONS, Action
from drone_env.core.compiled import kernel
from drone_env.core.episode import Episode, rollout
from drone_env.core.rewards import Rewards, get_reward_profile, tabulate_rewards
from drone_env.core.rules import score, score_of, step
from drone_env.core.tables import BATTERY, CELL, DELIVERED_FLAG, OUTCOME, PARCELS, STEPS, Tables, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.errors import EpisodeError
from drone_env.planning.returns import highest_returns
from drone_env.planning.states import UNPAID, require_memory, state_arrays, waiting_parcels


@kernel
def score_kernel(tables: Tables, scores: Any) -> None:
    """Write the score of every possible end into float64[deliveries + 1, capacity + 1, max_steps + 1]."""
    for deliveries in range(scores.shape[0]):
        for battery in range(scores.shape[1]):
            for steps in range(scores.shape[2]):
                scores[deliveries, battery, steps] = score_of(tables, deliveries, battery, steps)


@kernel
def step_kernel(tables: Tables, rewards: Rewards, grids: Any, states: Any, scratch: Any, scores: Any) -> None:
    """Fly each of the five actions from each of N states.

    Args:
        tables: The task's tables.
        rewards: Tables of any profile; not used.
        grids: uint8[N, cells]
        states: uint16[5 N, state size], each state five times. The k-th flies action k modulo 5.
        scratch: uint8[cells], working memory.
        scores: float64[5 N], receives the scores after the actions.
    """
    for k in range(len(states)):
        for cell in range(tables.cells):
            scratch[cell] = grids[k // N_ACTIONS, cell]
        step(tables, rewards, scratch, states[k], k % N_ACTIONS)
        scores[k] = score(tables, states[k])


@lru_cache(maxsize=16)
def ranked_scores(task: TaskConfig) -> tuple[npt.NDArray[np.float64], npt.NDArray[Any]]:
    """All scores of a task in ascending order, and the rank of each possible end.

    The ranks are [deliveries + 1, capacity + 1, max_steps + 1], uint16 if that is enough, else uint32.

    Raises:
        TooLargeError: if they would take more memory than `states.MAX_BYTES`.
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
        episode: An episode in flight; it is not changed.
    """

    def __init__(self, episode: Episode) -> None:
        if episode.ended:
            raise EpisodeError("the episode has ended: there is nothing left to solve")
        self._start = episode.copy()
        self._waiting = waiting_parcels(episode)

    @abstractmethod
    def _values_in_flight(self, states: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        """V* of N reachable states in flight, float64[N].

        Args:
            states: int64[N, 4]: set delivered, cell, battery units and steps left. Bit i of the set is the i-th parcel
                that was waiting in the solved state.
        """

    def q_values(self, episode: Episode) -> npt.NDArray[np.float64]:
        """Q*, float64[5]: the highest score that can still be reached after each action.

        Raises:
            EpisodeError: if the episode has ended, or does not go on from the solved one.
        """
        self._require_from_here(episode)
        _, state, _ = state_arrays(episode)
        return self.q_values_of(episode.grid().reshape(1, -1), state[None])[0]

    def q_values_of(self, grids: npt.NDArray[np.uint8], states: npt.NDArray[np.uint16]) -> npt.NDArray[np.float64]:
        """Q* of N states in flight, float64[N, 5]. It does not check that they are reachable.

        Args:
            grids: uint8[N, cells]
            states: uint16[N, state size]
        """
        task = self._start.task
        after, values = np.repeat(states, N_ACTIONS, axis=0), np.zeros(N_ACTIONS * len(states))
        scratch = np.zeros(task.width * task.height, np.uint8)
        step_kernel(tabulate(task), tabulate_rewards(task, UNPAID), grids, after, scratch, values)
        flying = after[:, OUTCOME] == FLYING
        flags = after[:, [PARCELS + parcel for parcel in self._waiting]] >= DELIVERED_FLAG
        delivered = flags @ (1 << np.arange(len(self._waiting)))
        left = np.int64(task.max_steps) - after[:, STEPS]
        rows = np.stack([delivered, after[:, CELL], after[:, BATTERY], left], axis=1).astype(np.int64)
        values[flying] = self._values_in_flight(rows[flying])
        return np.reshape(values, (-1, N_ACTIONS))

    def value(self, episode: Episode) -> float:
        """V*: the highest score that can still be reached; after the end, the score."""
        return episode.score if episode.ended else float(self.q_values(episode).max())

    def optimal_actions(self, episode: Episode) -> tuple[Action, ...]:
        """All actions after which the highest score can still be reached; raises as `q_values`."""
        values = self.q_values(episode)
        return tuple(Action(int(action)) for action in np.flatnonzero(values == values.max()))

    def best_actions(self) -> list[Action]:
        """One best sequence of actions from the solved state; the same in every run.

        If the episode has not ended then, only waiting remains.
        """
        flight = self._start.copy()
        rollout(flight, lambda _: self.optimal_actions(flight)[0])
        return [step.action for step in flight.path[len(self._start.actions) :]]

    def _require_from_here(self, episode: Episode) -> None:
        """Reject an episode that has ended, or does not go on from the solved one."""
        if episode.ended:
            raise EpisodeError("the episode has ended: it has no further actions")
        start = self._start
        flown = episode.task, episode.seed, episode.actions[: len(start.actions)]
        if flown != (start.task, start.seed, start.actions):
            raise EpisodeError("the solved episode cannot reach this state: create a solver for this episode")


class ExactSolver(Solver):
    """Values by dynamic programming over all states. It covers every task; `LegSolver` is a hundred times faster.

    Attributes:
        returns: The highest returns of the reward profile `score`, which are the values.

    Args:
        episode: An episode in flight; it is not changed.

    Raises:
        EpisodeError: if the episode has not started, or has ended.
        TooLargeError: if the values would take more memory than `states.MAX_BYTES`.
    """

    def __init__(self, episode: Episode) -> None:
        super().__init__(episode)
        self.returns = highest_returns(episode, get_reward_profile("score"), 1.0, of_targets=False)

    def _values_in_flight(self, states: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        delivered, cell, battery, left = states.T
        returns, t = self.returns, len(self.returns.sizes) - left
        return returns.values[t, battery - returns.lowest[t], delivered, 0, cell]
