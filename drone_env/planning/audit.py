"""Audit of rewards: the exact return-maximising flight over a map (see `returns`), and its score.

A reward is *aligned* on a map if this flight still scores the optimum.
"""

import math
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

from drone_env.core.actions import Action
from drone_env.core.episode import Episode, Observation, rollout
from drone_env.core.rewards import RewardProfile
from drone_env.core.tasks import TaskConfig
from drone_env.planning.optimal import solve_episode
from drone_env.planning.returns import highest_returns


@dataclass(frozen=True)
class MapAudit:
    """The audit of one reward on one map.

    Attributes:
        seed: Number of the map.
        optimum: The exact optimum of the score.
        score: The lowest score of all return-maximising flights.
        actions: The actions of that flight.
        maximum: Its discounted return.
        honest: The discounted return of a flight with the best score.
    """

    seed: int
    optimum: float
    score: float
    actions: tuple[Action, ...]
    maximum: float
    honest: float

    @property
    def aligned(self) -> bool:
        """Whether maximising the reward reaches the optimum."""
        return self.score == self.optimum


def audit_map(task: str | TaskConfig, seed: int, reward_profile: str | RewardProfile, gamma: float) -> MapAudit:
    """Audit a reward on one map, with the profile unchanged: `profile_for_discount` fits its shaping to a discount.

    Raises:
        TooLargeError: if the audit would take more memory than `states.MAX_BYTES`.
    """
    start = Episode(task, reward_profile, seed)
    solution = solve_episode(start)
    flight, maximum = _maximise(start, gamma)
    honest = sum(reward * gamma**t for t, reward in enumerate(start.copy().fly(solution.actions).rewards))
    actions = tuple(step.action for step in flight.path)
    return MapAudit(start.seed, solution.score, flight.score, actions, maximum, honest)


def audit_maps(task: TaskConfig, seeds: range, reward_profile: RewardProfile, gamma: float) -> Iterator[MapAudit]:
    """Yield the audits of these maps in order, in one thread per core."""
    one = partial(audit_map, task, reward_profile=reward_profile, gamma=gamma)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        yield one(seeds[0])  # the first map compiles the kernels for the others
        yield from pool.map(one, seeds[1:])


def summarise_audits(
    task: TaskConfig, reward_profile: RewardProfile, gamma: float, audits: Sequence[MapAudit]
) -> dict[str, Any]:
    """The report of the audits of consecutive maps, as JSON values."""

    def mean(values: Iterable[float]) -> float:
        return math.fsum(values) / len(audits)

    share = mean(audited.aligned for audited in audits)
    shaping = reward_profile.shaping_gamma
    worst = max(audits, key=lambda audited: (not audited.aligned, audited.optimum - audited.score))
    return {
        "task": task.id,
        "version": task.version,
        "reward": reward_profile.id,
        "gamma": gamma,
        "shaping_gamma": None if shaping is None else float(shaping),
        "seeds": [audits[0].seed, audits[-1].seed + 1],
        "maps": len(audits),
        "verdict": "aligned" if share == 1 else "exploitable",
        "share_aligned": share,
        "mean_score": mean(audited.score for audited in audits),
        "mean_optimal_score": mean(audited.optimum for audited in audits),
        "mean_returns": {
            "maximiser": mean(audited.maximum for audited in audits),
            "honest": mean(audited.honest for audited in audits),
        },
        "worst": {
            "seed": worst.seed,
            "score": worst.score,
            "optimal_score": worst.optimum,
            "actions": [action.name for action in worst.actions],
        },
    }


def _maximise(start: Episode, gamma: float) -> tuple[Episode, float]:
    """The return-maximising flight with the lowest score, and its return."""
    returns, flight = highest_returns(start, start.reward_profile, gamma, of_targets=True), start.copy()
    lowest = returns.lowest

    def act(_: Observation) -> int:
        t = flight.steps - start.steps
        return int(returns.choices[(t, flight.battery_units - lowest[t], *_aim(flight), flight.cell)])

    at_start = (0, start.battery_units - lowest[0], *_aim(start), start.cell)
    return rollout(flight, act), float(returns.values[at_start])


def _aim(flight: Episode) -> tuple[int, int]:
    """(delivered set, number of the target) of an episode that started with all parcels undelivered."""
    delivered = sum(done << i for i, (_, _, done) in enumerate(flight.parcels))
    return delivered, [(x, y) for x, y, _ in flight.parcels].index(flight.target or (-1, -1))
