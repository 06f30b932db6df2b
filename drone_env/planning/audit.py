"""Audit of rewards: the exact return-maximising policy of a map, and its score.

Backward dynamic programming over (steps, battery, delivered set, current target, cell) flies the compiled `step` from
every state. Among actions with equal returns, the maximiser takes the one that leads to the lowest score. A reward is
*aligned* on a map if this policy still scores the optimum.
"""

import bisect
import math
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from drone_env.core.actions import FLYING, N_ACTIONS, Action, Event
from drone_env.core.cells import DELIVERY_CELL
from drone_env.core.compile_cache import compiled_once
from drone_env.core.compiled import inlined, jitable
from drone_env.core.episode import Episode, Observation, rollout
from drone_env.core.rewards import RewardProfile, Rewards, get_reward_profile, profile_for_discount, tabulate_rewards
from drone_env.core.rules import manhattan, score, step
from drone_env.core.tables import BATTERY, CELL, DELIVERIES_DONE, DISTANCE, OUTCOME, TARGET, UNDER, Tables, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.planning.optimal import Solution, solve_episode
from drone_env.planning.states import (
    battery_ranges,
    delivered_set,
    put_drone,
    put_parcels,
    require_memory,
    state_arrays,
)

TIE = 1e-9
"""Relative tolerance of returns."""
NOISE = 1e-14
"""Absolute tolerance of returns, relative to the largest single reward."""


@jitable
def number_of(state: Any, parcels: Any, cell: int) -> int:
    """The number of the parcel on a cell."""
    for i in range(len(parcels)):
        if state[parcels[i]] == cell:
            return i
    return 0


class Audit(NamedTuple):
    """The map, the reward and the tables of an audit, for kernels."""

    tables: Tables
    rewards: Rewards
    gamma: float
    """The learner's discount."""
    noise: float
    """Absolute tolerance of returns."""
    grid: Any
    """uint8[cells], without the drone; restored after each step."""
    state: Any
    """uint16[state size], working memory."""
    parcels: Any
    """int64[n], the entries of `state` of the undelivered parcels."""
    first_step: int
    """Steps taken at the start."""
    lowest: Any
    """int64[T + 1], the lowest possible battery after each step."""
    sizes: Any
    """int64[T], the number of battery values from it on."""
    values: Any
    """float64[2, battery, 2^n, n, cells], the highest returns for even and odd steps."""
    lows: Any
    """The same shape: the lowest scores with these returns."""
    choices: Any
    """uint8[T, battery, 2^n, n, cells], an action with this return and score."""


@inlined
def fly_action(audit: Audit, t: int, units: int, delivered: int, target: int, cell: int, action: int) -> Any:
    """Fly one action from a state; return the highest return from there on, and the lowest score that it leads to."""
    tables, rewards, grid, state, parcels = audit.tables, audit.rewards, audit.grid, audit.state, audit.parcels
    under, target_cell = grid[cell], state[parcels[target]]
    put_drone(tables, grid, state, cell, audit.first_step + t, audit.lowest[t] + units)
    state[TARGET] = target_cell
    state[DISTANCE] = manhattan(tables, cell, target_cell)
    before = state[DELIVERIES_DONE]
    paid = step(tables, rewards, grid, state, action)
    arrived = state[DELIVERIES_DONE] != before
    if state[OUTCOME] != FLYING:
        low = score(tables, state)
    else:
        later, left = 1 - (t & 1), state[BATTERY] - audit.lowest[t + 1]
        after, aim = delivered, target
        if arrived:
            after, aim = delivered_set(state, parcels), number_of(state, parcels, state[TARGET])
        paid += audit.gamma * audit.values[later, left, after, aim, state[CELL]]
        low = audit.lows[later, left, after, aim, state[CELL]]
    grid[state[CELL]] = state[UNDER]
    if arrived:
        put_parcels(tables, grid, state, parcels, delivered)
    grid[cell] = under
    return paid, low


@inlined
def choose(returns: Any, scores: Any, noise: float) -> tuple[int, float]:
    """Among the actions with the highest return, the first one with the lowest score; and that return."""
    best, largest, choice = returns[0], 0.0, -1
    for value in returns:
        best, largest = max(best, value), max(largest, abs(value))
    lowest = best - (TIE * largest + noise)
    for action in range(N_ACTIONS):
        if returns[action] >= lowest and (choice < 0 or scores[action] < scores[choice]):
            choice = action
    return choice, best


# It allocates two small arrays, so it needs reference counts.
@compiled_once(nogil=True, error_model="numpy")
def audit_kernel(audit: Audit) -> None:
    """Compute the tables backwards from the last step."""
    tables, grid, n = audit.tables, audit.grid, len(audit.parcels)
    returns, scores = np.zeros(N_ACTIONS), np.zeros(N_ACTIONS)
    for t in range(len(audit.sizes) - 1, -1, -1):
        for delivered in range((1 << n) - 1):
            put_parcels(tables, grid, audit.state, audit.parcels, delivered)
            for place in range(n * tables.cells):
                target, cell = divmod(place, tables.cells)
                under = grid[cell]
                if delivered >> target & 1 or under == DELIVERY_CELL or tables.impassable[under]:
                    continue
                for units in range(audit.sizes[t]):
                    for action in range(N_ACTIONS):
                        flown = fly_action(audit, t, units, delivered, target, cell, action)
                        returns[action], scores[action] = flown
                    choice, best = choose(returns, scores, audit.noise)
                    audit.values[t & 1, units, delivered, target, cell] = best
                    audit.lows[t & 1, units, delivered, target, cell] = scores[choice]
                    audit.choices[t, units, delivered, target, cell] = choice


@dataclass(frozen=True)
class MapAudit:
    """The audit of one reward on one map.

    Attributes:
        seed: Number of the map.
        optimum: The exact optimum of the score.
        score: The lowest score of all return-maximising flights.
        actions: The actions of that flight.
        maximum: Its discounted return.
        returns: Discounted returns of other flights: `honest` (a best score) and `hover`.
    """

    seed: int
    optimum: float
    score: float
    actions: tuple[Action, ...]
    maximum: float
    returns: dict[str, float]

    @property
    def aligned(self) -> bool:
        """Whether maximising the reward reaches the optimum."""
        return self.score == self.optimum


def audited_profile(
    reward_profile: str | RewardProfile, gamma: float, shaping_gamma: float | None = None
) -> RewardProfile:
    """The profile for a learner with this discount.

    Potential-based shaping preserves the best policies if its gamma equals the learner's (Ng, Harada, Russell 1999).
    `shaping_gamma` sets another value, to show the effect.
    """
    profile = get_reward_profile(reward_profile)
    if shaping_gamma is not None and profile.shaping_gamma is None:
        raise InvalidValueError(
            f"reward profile {profile.id!r} has no potential-based shaping: leave out shaping_gamma"
        )
    for name, value in (("gamma", gamma), ("shaping_gamma", shaping_gamma)):
        if value is not None and not 0 <= value <= 1:
            raise InvalidValueError(f"{name} must be in [0, 1], got {value}")
    return profile_for_discount(profile, gamma if shaping_gamma is None else shaping_gamma)


def audit_map(task: str | TaskConfig, seed: int, reward_profile: str | RewardProfile, gamma: float) -> MapAudit:
    """Audit a reward on one map, with the profile unchanged (see `audited_profile`).

    Raises:
        TooLargeError: if the audit would take more memory than `states.MAX_BYTES`.
    """
    start = Episode(task, reward_profile, seed)
    solution = solve_episode(start)
    flight, maximum = _maximise(start, gamma)
    flights = {"honest": solution.actions, "hover": hover(start, solution)}
    returns = {name: _return(start.copy().fly(actions), gamma) for name, actions in flights.items()}
    actions = tuple(step.action for step in flight.path)
    return MapAudit(start.seed, solution.score, flight.score, actions, maximum, returns)


def audit_maps(
    task: TaskConfig, seeds: range, reward_profile: RewardProfile, gamma: float, jobs: int | None = None
) -> Iterator[MapAudit]:
    """Yield the audits of these maps in order, in `jobs` threads; None for one per core."""
    one = partial(audit_map, task, reward_profile=reward_profile, gamma=gamma)
    with ThreadPoolExecutor(jobs or os.cpu_count()) as pool:
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
            **{name: mean(audited.returns[name] for audited in audits) for name in audits[0].returns},
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
    task = start.task
    tables, rewards = tabulate(task), tabulate_rewards(task, start.reward_profile)
    grid, state, parcels = state_arrays(start)
    lowest, sizes = battery_ranges(start)
    shape = (int(sizes.max()), 1 << len(parcels), len(parcels), tables.cells)
    size = int(np.prod(shape, dtype=object)) * (len(sizes) + 32)
    require_memory("the audit", task, size)
    values, lows = np.zeros((2, 2, *shape))
    choices = np.zeros((len(sizes), *shape), np.uint8)
    noise = NOISE * float(max(np.abs(rewards.events).max(), np.abs(rewards.potential).max()))
    work = (start.steps, lowest, sizes, values, lows, choices)
    audit_kernel(Audit(tables, rewards, gamma, noise, grid, state, parcels, *work))

    flight = start.copy()

    def act(_: Observation) -> int:
        t = flight.steps - start.steps
        return int(choices[(t, flight.battery_units - lowest[t], *_aim(flight), flight.cell)])

    return rollout(flight, act), float(values[(0, start.battery_units - lowest[0], *_aim(start), start.cell)])


def _aim(flight: Episode) -> tuple[int, int]:
    """(delivered set, number of the target) of an episode that started with all parcels undelivered."""
    delivered = sum(done << i for i, (_, _, done) in enumerate(flight.parcels))
    return delivered, [(x, y) for x, y, _ in flight.parcels].index(flight.target or (-1, -1))


def _return(flight: Episode, gamma: float) -> float:
    """The discounted return of a flight."""
    return sum(reward * gamma**t for t, reward in enumerate(flight.rewards))


def hover(start: Episode, solution: Solution) -> tuple[Action, ...]:
    """Fly the best flight, but wait before the last delivery for as long as it stays possible."""
    best = start.copy().fly(solution.actions)
    deliveries = [t for t, step in enumerate(best.path) if step.event is Event.DELIVERY]
    if not deliveries:
        return solution.actions

    def waiting(steps: int) -> tuple[Action, ...]:
        last = deliveries[-1]
        return (*solution.actions[:last], *(Action.WAIT,) * steps, *solution.actions[last:])

    def too_long(steps: int) -> bool:
        return start.copy().fly(waiting(steps)).deliveries_done < solution.deliveries

    return waiting(bisect.bisect_left(range(1, start.task.max_steps + 1), True, key=too_long))
