"""N episodes of one task at once: the functions of `dynamics`, compiled, in one loop over the episodes.

Every buffer of a `Batch` is overwritten by the next step; whoever keeps one copies it.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numba  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
import numpy.typing as npt

from drone_env.core import compiled
from drone_env.core.actions import N_ACTIONS, Event, Outcome
from drone_env.core.dynamics import reset as reset_episode
from drone_env.core.dynamics import step as step_episode
from drone_env.core.observation import (
    open_actions,
    write_own_telemetry,
    write_target_telemetry,
    write_telemetry,
)
from drone_env.core.rewards import RewardProfile, Rewards, get_reward_profile, tabulate_rewards
from drone_env.core.rules import DELIVERIES, EVENT, OUTCOME, STEPS, Rules, row_size, tabulate
from drone_env.core.score import score
from drone_env.core.seeds import N_SEEDS, next_seed
from drone_env.core.state_manager import ALLOWED_ACTIONS
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import EpisodeError, InvalidValueError

FLYING = int(Outcome.FLYING)
DELIVERED = int(Event.DELIVERY)


class Buffers(NamedTuple):
    """The arrays of a batch of N episodes, as the kernels see them."""

    grids: Any
    """uint8[N, cells]"""
    rows: Any
    """uint16[N, row size]"""
    seeds: Any
    """int64[N], the map of each episode"""
    telemetry: Any
    """float32[N, 5 or 6]"""
    open_actions: Any
    """uint8[N], the actions that do not bump, as bits (1 << action)"""
    rewards: Any
    """float64[N]"""
    terminated: Any
    """bool[N]"""
    ended: Any
    """int64[N], the episodes that the last step ended, from the start of each thread's range on"""
    final_grids: Any
    """uint8[N, cells], in the order of `ended`, as are the following"""
    final_telemetry: Any
    final_scores: Any
    final_steps: Any
    final_deliveries: Any
    final_seeds: Any


@numba.njit(nogil=True, **compiled.OPTIONS)
def reset_kernel(rules: Rules, buffers: Buffers, chosen: Any) -> None:
    """Begin the episodes whose numbers are in `chosen`, on the maps that stand in `seeds`."""
    for i in chosen:
        grid, row = buffers.grids[i], buffers.rows[i]
        reset_episode(rules, grid, row, buffers.seeds[i])
        write_telemetry(rules, row, buffers.telemetry[i])
        buffers.open_actions[i] = open_actions(rules, grid, row)
        buffers.rewards[i] = 0.0
        buffers.terminated[i] = False


@numba.njit(nogil=True, **compiled.OPTIONS)
def step_kernel(
    rules: Rules, rewards: Rewards, buffers: Buffers, actions: Any, start: int, stop: int, same_step: bool
) -> int:
    """Step the episodes from `start` to `stop` and return how many ended."""
    n_ended = 0
    for i in range(start, stop):
        grid, row, telemetry = buffers.grids[i], buffers.rows[i], buffers.telemetry[i]
        fresh = False
        if buffers.terminated[i] and not same_step:
            buffers.seeds[i] = next_seed(buffers.seeds[i])
            reset_episode(rules, grid, row, buffers.seeds[i])
            buffers.rewards[i] = 0.0
            buffers.terminated[i] = False
            fresh = True
        else:
            buffers.rewards[i] = step_episode(rules, rewards, grid, row, actions[i])
            over = row[OUTCOME] != FLYING
            buffers.terminated[i] = over
            if over:
                k = start + n_ended
                n_ended += 1
                buffers.ended[k] = i
                buffers.final_scores[k] = score(rules, row)
                buffers.final_steps[k] = row[STEPS]
                buffers.final_deliveries[k] = row[DELIVERIES]
                buffers.final_seeds[k] = buffers.seeds[i]
                if same_step:
                    for cell in range(rules.cells):
                        buffers.final_grids[k, cell] = grid[cell]
                    write_telemetry(rules, row, buffers.final_telemetry[k])
                    buffers.seeds[i] = next_seed(buffers.seeds[i])
                    reset_episode(rules, grid, row, buffers.seeds[i])
                    fresh = True
        write_own_telemetry(rules, row, telemetry)
        if fresh or row[EVENT] == DELIVERED:
            write_target_telemetry(rules, row, telemetry)
        buffers.open_actions[i] = open_actions(rules, grid, row)
    return n_ended


@numba.njit(parallel=True, nogil=True)
def step_kernel_threads(
    rules: Rules, rewards: Rewards, buffers: Buffers, actions: Any, bounds: Any, same_step: bool, n_ended: Any
) -> None:
    """Step the ranges between neighbouring `bounds`, one thread each."""
    for t in numba.prange(len(bounds) - 1):
        n_ended[t] = step_kernel(rules, rewards, buffers, actions, bounds[t], bounds[t + 1], same_step)


class Batch:
    """N episodes of one task, stepped together.

    Attributes, all arrays over the episodes and overwritten by the next step:
        grids: uint8[N, height, width], cell ids as the drone sees them.
        telemetry: float32[N, 5] (or 6).
        open_actions: uint8[N], the actions that do not bump, as bits (1 << action).
        rewards: float64[N], of the last step.
        terminated: bool[N], whether the last step ended the episode.
        seeds: int64[N], the map that each episode flies.

    Attributes about the episodes that the last step ended, one entry each:
        ended: int64[k], their numbers.
        final_scores, final_steps, final_deliveries, final_seeds: float64, int64, int64, int64[k].
        final_grids, final_telemetry: their last observation, where `same_step` has already replaced it.

    Args:
        task: A task or its name.
        num_envs: N, at least 1.
        reward_profile: A reward profile or its name.
        same_step: Whether a step that ends an episode begins the next one at once; otherwise the following step does,
            whatever its action. Either way it flies the map that `seeds.next_seed` names.
        num_threads: How many threads share a step.

    Raises:
        UnknownNameError: if there is no such task or profile.
        InvalidValueError: if a number is below 1.
    """

    def __init__(
        self,
        task: str | TaskConfig,
        num_envs: int,
        reward_profile: str | RewardProfile = "aligned",
        same_step: bool = False,
        num_threads: int = 1,
    ) -> None:
        for name, value in (("num_envs", num_envs), ("num_threads", num_threads)):
            if value < 1:
                raise InvalidValueError(f"{name} must be at least 1, got {value}")
        self.task = get_task(task)
        self.num_envs = num_envs
        self.reward_profile = get_reward_profile(reward_profile)
        self.same_step = same_step
        self.rules = tabulate(self.task)
        self._rewards = tabulate_rewards(self.task, self.reward_profile)
        cells, size = self.rules.cells, self.task.telemetry_size
        finals = num_envs if same_step else 0
        self._buffers = Buffers(
            grids=np.zeros((num_envs, cells), np.uint8),
            rows=np.zeros((num_envs, row_size(self.rules)), np.uint16),
            seeds=np.zeros(num_envs, np.int64),
            telemetry=np.zeros((num_envs, size), np.float32),
            open_actions=np.zeros(num_envs, np.uint8),
            rewards=np.zeros(num_envs, np.float64),
            terminated=np.zeros(num_envs, np.bool_),
            ended=np.zeros(num_envs, np.int64),
            final_grids=np.zeros((finals, cells), np.uint8),
            final_telemetry=np.zeros((finals, size), np.float32),
            final_scores=np.zeros(num_envs, np.float64),
            final_steps=np.zeros(num_envs, np.int64),
            final_deliveries=np.zeros(num_envs, np.int64),
            final_seeds=np.zeros(num_envs, np.int64),
        )
        self.grids = self._buffers.grids.reshape(num_envs, self.task.height, self.task.width)
        self.telemetry = self._buffers.telemetry
        self.open_actions = self._buffers.open_actions
        self.rewards = self._buffers.rewards
        self.terminated = self._buffers.terminated
        self.seeds = self._buffers.seeds
        self._started = np.zeros(num_envs, np.bool_)
        self._all_started = False
        bounds = np.linspace(0, num_envs, min(num_threads, num_envs) + 1).astype(np.int64)
        self._bounds = bounds
        self._n_ended = np.zeros(len(bounds) - 1, np.int64)

    def reset(self, seeds: Sequence[int] | npt.NDArray[np.int64], chosen: npt.NDArray[np.bool_] | None = None) -> None:
        """Begin episodes on the maps of these seeds.

        Args:
            seeds: One for each episode, in [0, 2^53).
            chosen: bool[N], which episodes to begin; None for all. The seeds of the others are not used.

        Raises:
            InvalidValueError: if the seeds are not N integers in [0, 2^53); nothing is changed.
        """
        values = np.asarray(seeds)
        if values.shape != (self.num_envs,) or values.dtype.kind not in "iu":
            raise InvalidValueError(f"seeds must be {self.num_envs} integers, got {values.dtype}{list(values.shape)}")
        numbers = np.arange(self.num_envs) if chosen is None else np.flatnonzero(chosen)
        if len(numbers) and not (values[numbers].min() >= 0 and values[numbers].max() < N_SEEDS):
            raise InvalidValueError("seeds must be integers in [0, 2^53)")
        self.seeds[numbers] = values[numbers]
        reset_kernel(self.rules, self._buffers, numbers)
        self._started[numbers] = True
        self._all_started = bool(self._started.all())
        self._n_ended[:] = 0

    def step(self, actions: npt.ArrayLike) -> None:
        """Fly one action in each episode and overwrite the buffers.

        Args:
            actions: N integers from 0 to 4. In an episode that is to begin anew its action is not used.

        Raises:
            InvalidValueError: if they are not; nothing is flown.
            EpisodeError: if some episode has not been reset yet.
        """
        values: Any = np.asarray(actions)
        if values.shape != (self.num_envs,) or values.dtype.kind not in "iu":
            raise InvalidValueError(f"actions must be {self.num_envs} integers, got {values.dtype}{list(values.shape)}")
        if not self._all_started:
            raise EpisodeError("some episodes have not begun: call reset() before step()")
        # As unsigned numbers: what is below zero is then above the highest action.
        values = values.astype(np.int64, copy=False).view(np.uint64)
        if values.max() >= N_ACTIONS:
            wrong = values[values >= N_ACTIONS][0]
            raise InvalidValueError(f"actions must be among {ALLOWED_ACTIONS}; got {np.int64(wrong)}")
        bounds = self._bounds
        if len(bounds) == 2:
            self._n_ended[0] = step_kernel(
                self.rules, self._rewards, self._buffers, values, 0, self.num_envs, self.same_step
            )
        else:
            step_kernel_threads(self.rules, self._rewards, self._buffers, values, bounds, self.same_step, self._n_ended)
