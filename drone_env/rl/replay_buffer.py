"""What the trainer has seen, in arrays that are allocated once."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.errors import InvalidValueError


class Transitions(NamedTuple):
    """A batch of B transitions over up to n steps."""

    grids: npt.NDArray[np.uint8]
    """uint8[B, H, W]"""
    telemetry: npt.NDArray[np.float32]
    """float32[B, telemetry_size]"""
    actions: npt.NDArray[np.int64]
    """int64[B]"""
    returns: npt.NDArray[np.float32]
    """float32[B], the discounted rewards of the steps"""
    discounts: npt.NDArray[np.float32]
    """float32[B], what the value of the next state counts: gamma^n, or 0 where the episode ended on the way"""
    next_grids: npt.NDArray[np.uint8]
    next_telemetry: npt.NDArray[np.float32]


class ReplayBuffer:
    """The last steps of N episodes flown side by side, one row of N for each step.

    An observation is stored once: the next one of an episode stands in the next row. Where an episode ended, that row
    holds the first observation of the one after it, which is never used, since nothing follows an end.

    Args:
        capacity: Transitions to hold; rounded down to whole rows.
        num_envs: N.
        height, width: Size of the grid.
        telemetry_size: Values in the telemetry.

    Raises:
        InvalidValueError: if the capacity does not hold two rows.
    """

    def __init__(self, capacity: int, num_envs: int, height: int, width: int, telemetry_size: int) -> None:
        rows = capacity // num_envs
        if rows < 2:
            raise InvalidValueError(f"a replay of {capacity} does not hold two steps of {num_envs} episodes")
        self.grids = np.zeros((rows, num_envs, height, width), np.uint8)
        self.telemetry = np.zeros((rows, num_envs, telemetry_size), np.float32)
        self.actions = np.zeros((rows, num_envs), np.uint8)
        self.rewards = np.zeros((rows, num_envs), np.float32)
        self.terminated = np.zeros((rows, num_envs), np.bool_)
        self.added = 0
        """Rows written so far."""

    @property
    def held(self) -> int:
        """Rows that it holds now."""
        return min(self.added, len(self.grids))

    def add(
        self,
        grids: npt.NDArray[np.uint8],
        telemetry: npt.NDArray[np.float32],
        actions: npt.NDArray[np.int64],
        rewards: npt.NDArray[np.float64],
        terminated: npt.NDArray[np.bool_],
    ) -> None:
        """Store one step of all episodes: what was seen, what was done, and what came next; the oldest goes."""
        row = self.added % len(self.grids)
        self.grids[row] = grids
        self.telemetry[row] = telemetry
        self.actions[row] = actions
        self.rewards[row] = rewards
        self.terminated[row] = terminated
        self.added += 1

    def can_sample(self, n_step: int) -> bool:
        """Whether there is a transition over this many steps."""
        return self.held > n_step

    def sample(self, batch_size: int, n_step: int, gamma: float, rng: np.random.Generator) -> Transitions:
        """Transitions drawn uniformly, each over `n_step` steps or up to the end of its episode.

        Raises:
            InvalidValueError: if fewer than `n_step` + 1 rows have been written.
        """
        if not self.can_sample(n_step):
            raise InvalidValueError(f"{self.added} steps have been stored; {n_step + 1} are needed")
        rows = len(self.grids)
        first = self.added - self.held + rng.integers(0, self.held - n_step, batch_size)
        env = rng.integers(0, self.grids.shape[1], batch_size)
        returns = np.zeros(batch_size, np.float32)
        discounts = np.ones(batch_size, np.float32)
        for i in range(n_step):
            row = (first + i) % rows
            returns += discounts * self.rewards[row, env]
            discounts *= gamma * ~self.terminated[row, env]
        now, later = first % rows, (first + n_step) % rows
        return Transitions(
            self.grids[now, env],
            self.telemetry[now, env],
            self.actions[now, env].astype(np.int64),
            returns,
            discounts,
            self.grids[later, env],
            self.telemetry[later, env],
        )
