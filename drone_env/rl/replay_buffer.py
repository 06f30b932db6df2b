"""The replay buffer, in arrays that are allocated once."""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt


class Transitions(NamedTuple):
    """A batch of B transitions."""

    grids: npt.NDArray[np.uint8]
    """uint8[B, H, W]"""
    telemetry: npt.NDArray[np.float32]
    """float32[B, telemetry_size]"""
    actions: npt.NDArray[np.int64]
    """int64[B]"""
    rewards: npt.NDArray[np.float32]
    """float32[B]"""
    discounts: npt.NDArray[np.float32]
    """float32[B], discount of the next state's value: gamma, or 0 if the episode ended"""
    next_grids: npt.NDArray[np.uint8]
    next_telemetry: npt.NDArray[np.float32]


class ReplayBuffer:
    """The last steps of N environments, one row of N for each step.

    Each observation is stored once: the next one is in the next row. After an end, the next row holds the first
    observation of another episode, which no target uses.

    Args:
        capacity: Transitions to hold, rounded down to whole rows; at least two of them.
        num_envs: N.
        height, width: Size of the grid.
        telemetry_size: Values in the telemetry.
    """

    def __init__(self, capacity: int, num_envs: int, height: int, width: int, telemetry_size: int) -> None:
        rows = capacity // num_envs
        self.grids = np.zeros((rows, num_envs, height, width), np.uint8)
        self.telemetry = np.zeros((rows, num_envs, telemetry_size), np.float32)
        self.actions = np.zeros((rows, num_envs), np.uint8)
        self.rewards = np.zeros((rows, num_envs), np.float32)
        self.terminated = np.zeros((rows, num_envs), np.bool_)
        self.added = 0
        """Rows written so far."""

    @property
    def stored(self) -> int:
        """Rows in the buffer."""
        return min(self.added, len(self.grids))

    @property
    def _columns(self) -> dict[str, npt.NDArray[Any]]:
        return {name: column for name, column in vars(self).items() if name != "added"}

    def add(
        self,
        grids: npt.NDArray[np.uint8],
        telemetry: npt.NDArray[np.float32],
        actions: npt.NDArray[np.int64],
        rewards: npt.NDArray[np.float64],
        terminated: npt.NDArray[np.bool_],
    ) -> None:
        """Store one step of all environments; it replaces the oldest."""
        row = self.added % len(self.grids)
        for column, values in zip(
            self._columns.values(), (grids, telemetry, actions, rewards, terminated), strict=True
        ):
            column[row] = values
        self.added += 1

    def sample(self, batch_size: int, gamma: float, rng: np.random.Generator) -> Transitions:
        """Uniformly sampled transitions; the buffer holds at least two rows."""
        rows = len(self.grids)
        first = self.added - self.stored + rng.integers(0, self.stored - 1, batch_size)
        env = rng.integers(0, self.grids.shape[1], batch_size)
        now, later = first % rows, (first + 1) % rows
        return Transitions(
            self.grids[now, env],
            self.telemetry[now, env],
            self.actions[now, env].astype(np.int64),
            self.rewards[now, env],
            np.float32(gamma) * ~self.terminated[now, env],
            self.grids[later, env],
            self.telemetry[later, env],
        )

    def get_state(self) -> dict[str, npt.NDArray[Any]]:
        """The rows in the buffer, and how many were written."""
        return {name: column[: self.stored] for name, column in self._columns.items()} | {"added": np.array(self.added)}

    def set_state(self, state: dict[str, npt.NDArray[Any]]) -> None:
        """Take the rows of another buffer of the same size."""
        self.added = int(state["added"])
        for name, column in self._columns.items():
            column[: self.stored] = state[name]
