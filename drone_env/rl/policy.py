"""The choice of actions in training: epsilon-greedy, and the schedules of epsilon."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from pydantic import PositiveInt

from drone_env.rl.config import Share, check_values


def linear(start: float, end: float, duration: int, step: int) -> float:
    """From `start` to `end` in `duration` steps, in a straight line; then `end`."""
    return end if step >= duration else start + step / duration * (end - start)


def multiplicative(start: float, end: float, factor: float, episode: int) -> float:
    """`start`, times `factor` for each episode, never below `end`."""
    return max(start * factor**episode, end)


@dataclass(frozen=True)
class EpsilonGreedyPolicy:
    """A uniformly random action with probability epsilon, else the action with the highest value.

    Args:
        eps_start: Probability at step 0.
        eps_end: Probability from `decay_steps` on.
        decay_steps: Steps of the linear decay.
    """

    eps_start: Share = 1.0
    eps_end: Share = 0.05
    decay_steps: PositiveInt = 5000

    def __post_init__(self) -> None:
        check_values(self)

    def epsilon(self, step: int) -> float:
        """The probability of a random action after this many steps."""
        return linear(self.eps_start, self.eps_end, self.decay_steps, step)

    def act(self, q_values: npt.NDArray[np.float32], step: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
        """Actions, int64[N], for values float32[N, actions]."""
        return epsilon_greedy(q_values, self.epsilon(step), rng)


def epsilon_greedy(
    q_values: npt.NDArray[np.float32], epsilon: float, rng: np.random.Generator
) -> npt.NDArray[np.int64]:
    """Actions, int64[N], from values float32[N, actions]: random with probability epsilon, else the best.

    The random numbers do not depend on epsilon, so runs with different exploration stay comparable.
    """
    n, n_actions = q_values.shape
    explores = np.asarray(rng.random(n), np.float64) < epsilon
    random_actions = np.asarray(rng.integers(0, n_actions, n), np.int64)
    return np.where(explores, random_actions, q_values.argmax(axis=1))
