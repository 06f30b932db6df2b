"""How much of an agent's flying is chance, and the policy that mixes it in."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drone_env.errors import InvalidValueError


@dataclass(frozen=True)
class LinearSchedule:
    """From `start` to `end` in `duration` steps, in a straight line; then `end`."""

    start: float
    end: float
    duration: int

    def __post_init__(self) -> None:
        if self.duration < 1:
            raise InvalidValueError(f"a schedule lasts at least 1 step, got {self.duration}")

    def __call__(self, step: int) -> float:
        """The value after this many steps."""
        share = min(max(step / self.duration, 0.0), 1.0)
        return self.start + share * (self.end - self.start)


@dataclass(frozen=True)
class MultiplicativeSchedule:
    """`start`, times `factor` for each episode, never below `end`."""

    start: float
    end: float
    factor: float

    def __post_init__(self) -> None:
        if not 0 < self.factor <= 1:
            raise InvalidValueError(f"factor must be in (0, 1], got {self.factor}")

    def __call__(self, episode: int) -> float:
        """The value after this many episodes."""
        return max(self.start * self.factor**episode, self.end)


class EpsilonGreedyPolicy:
    """A uniformly random action with probability epsilon, else the one of the highest value.

    Args:
        eps_start: Probability at step 0.
        eps_end: Probability from `decay_steps` on.
        decay_steps: How many steps the linear decay takes.

    Raises:
        InvalidValueError: if a probability is not in [0, 1] or `decay_steps` is below 1.
    """

    def __init__(self, eps_start: float = 1.0, eps_end: float = 0.05, decay_steps: int = 5000) -> None:
        if not (0 <= eps_end <= 1 and 0 <= eps_start <= 1):
            raise InvalidValueError(f"epsilon is a probability, got {eps_start} to {eps_end}")
        self.schedule = LinearSchedule(eps_start, eps_end, decay_steps)

    def epsilon(self, step: int) -> float:
        """The probability of a random action after this many steps."""
        return self.schedule(step)

    def act(self, q_values: npt.NDArray[np.float32], step: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
        """Actions, int64[N], for values float32[N, actions]."""
        return epsilon_greedy(q_values, self.epsilon(step), rng)


def epsilon_greedy(
    q_values: npt.NDArray[np.float32], epsilon: float, rng: np.random.Generator
) -> npt.NDArray[np.int64]:
    """Actions, int64[N], from values float32[N, actions]: random with probability epsilon, else of the highest value.

    It draws the same numbers whatever epsilon is, so that a run can be compared with one that explores less.
    """
    n, n_actions = q_values.shape
    explores = np.asarray(rng.random(n), np.float64) < epsilon
    chance = np.asarray(rng.integers(0, n_actions, n), np.int64)
    return np.where(explores, chance, q_values.argmax(axis=1))
