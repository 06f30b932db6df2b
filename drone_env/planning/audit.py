"""Audit of rewards: the exact return-maximising policy of a map, and the score of that policy.

Dynamic programming backwards over (steps, battery, delivered set, current target, cell), with the compiled `step`
itself flown from every state, so that no reward is worked out a second time. Among actions with the same return the
maximiser takes the one that ends in the lowest score: a reward is *aligned* on a map if even so it scores the optimum.
"""

import bisect
import math
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from drone_env.core.actions import FLYING, N_ACTIONS, Action, Event
from drone_env.core.cells import DELIVERY_CELL
from drone_env.core.compile_cache import compiled_once
from drone_env.core.compiled import jitable
from drone_env.core.episode import Episode, rollout
from drone_env.core.observation import Observation
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
"""Returns count as equal if they differ by less than this share of the largest of them."""
NOISE = 1e-14
"""And if they differ by less than this share of the largest single reward: returns are sums of rounded numbers."""


@jitable
def number_of(state: Any, parcels: Any, cell: int) -> int:
    """The number of the parcel on a cell."""
    for i in range(len(parcels)):
        if state[parcels[i]] == cell:
            return i
    return 0


# It allocates two small arrays, so it needs the runtime that the other kernels do without.
@compiled_once(nogil=True, error_model="numpy")
def audit_kernel(
    tables: Tables,
    rewards: Rewards,
    gamma: float,
    noise: float,
    grid: Any,
    state: Any,
    parcels: Any,
    first_step: int,
    lowest: Any,
    sizes: Any,
    values: Any,
    lows: Any,
    choices: Any,
) -> None:
    """Fill the tables from the last step backwards.

    Args:
        tables: The task's tables.
        rewards: The profile's tables.
        gamma: The learner's discount.
        noise: What returns may differ by, by rounding alone.
        grid: uint8[cells], without the drone; left as it was.
        state: uint16[state size], working memory.
        parcels: int64[n], the entries of `state` that hold the parcels still to deliver.
        first_step: Steps taken when the planning starts.
        lowest: int64[T + 1], the lowest battery that can be left after each step.
        sizes: int64[T], how many values of the battery from there on.
        values: float64[2, battery, 2^n, n, cells], the highest return from the states of even and of odd steps.
        lows: The same shape: the lowest score with which that return can be had.
        choices: uint8[T, battery, 2^n, n, cells], an action that leads there.
    """
    n = len(parcels)
    returns = np.zeros(N_ACTIONS)
    scores = np.zeros(N_ACTIONS)
    for t in range(len(sizes) - 1, -1, -1):
        now, later = t & 1, 1 - (t & 1)
        for delivered in range((1 << n) - 1):
            put_parcels(tables, grid, state, parcels, delivered)
            for target in range(n):
                if delivered >> target & 1:
                    continue
                target_cell = state[parcels[target]]
                for cell in range(tables.cells):
                    under = grid[cell]
                    if under == DELIVERY_CELL or tables.impassable[under]:
                        continue
                    for units in range(sizes[t]):
                        for action in range(N_ACTIONS):
                            put_drone(tables, grid, state, cell, first_step + t, lowest[t] + units)
                            state[TARGET] = target_cell
                            state[DISTANCE] = manhattan(tables, cell, target_cell)
                            before = state[DELIVERIES_DONE]
                            returns[action] = step(tables, rewards, grid, state, action)
                            arrived = state[DELIVERIES_DONE] != before
                            if state[OUTCOME] != FLYING:
                                scores[action] = score(tables, state)
                            else:
                                left = state[BATTERY] - lowest[t + 1]
                                after, aim = delivered, target
                                if arrived:
                                    after = delivered_set(state, parcels)
                                    aim = number_of(state, parcels, state[TARGET])
                                returns[action] += gamma * values[later, left, after, aim, state[CELL]]
                                scores[action] = lows[later, left, after, aim, state[CELL]]
                            grid[state[CELL]] = state[UNDER]
                            if arrived:
                                put_parcels(tables, grid, state, parcels, delivered)
                            grid[cell] = under
                        best = returns.max()
                        tie = TIE * np.abs(returns).max() + noise
                        choice = -1
                        for action in range(N_ACTIONS):
                            tied = returns[action] >= best - tie
                            if tied and (choice < 0 or scores[action] < scores[choice]):
                                choice = action
                        values[now, units, delivered, target, cell] = best
                        lows[now, units, delivered, target, cell] = scores[choice]
                        choices[t, units, delivered, target, cell] = choice


@dataclass(frozen=True)
class MapAudit:
    """One reward on one map.

    Attributes:
        seed: Number of the map.
        optimum: The exact optimum of the score.
        score: What the return-maximising flight scores; of several such flights, the one with the lowest score.
        actions: That flight.
        maximum: Its return, discounted.
        returns: Discounted returns of other flights: `honest` (the best score) and the hacks of `HACKS`.
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
    """The profile as a learner with this discount is paid.

    Potential-based shaping leaves the best policies as they are if its gamma is the learner's (Ng, Harada, Russell
    1999), so it is set to that; `shaping_gamma` keeps it at another value, to see what that does.

    Raises:
        UnknownNameError: if there is no such profile.
        InvalidValueError: if a gamma is not in [0, 1], or a `shaping_gamma` is given for a profile without shaping.
    """
    profile = get_reward_profile(reward_profile)
    if shaping_gamma is not None and profile.shaping_gamma is None:
        raise InvalidValueError(f"reward profile {profile.id!r} has no shaping that a shaping_gamma could be set for")
    for name, value in (("gamma", gamma), ("shaping_gamma", shaping_gamma)):
        if value is not None and not 0 <= value <= 1:
            raise InvalidValueError(f"{name} must be in [0, 1], got {value}")
    return profile_for_discount(profile, gamma if shaping_gamma is None else shaping_gamma)


def audit_map(task: str | TaskConfig, seed: int, reward_profile: str | RewardProfile, gamma: float) -> MapAudit:
    """Audit a reward on one map, exactly as the profile stands (see `audited_profile`).

    Raises:
        UnknownNameError: if there is no such task or profile.
        InvalidValueError: if the seed is not in [0, 2^53).
        TooLargeError: if it would take more memory than `states.MAX_BYTES`.
    """
    start = Episode(task, reward_profile, seed)
    solution = solve_episode(start)
    flight, maximum = _maximise(start, gamma)
    flights = {"honest": solution.actions} | {name: hack(start, solution) for name, hack in HACKS.items()}
    returns = {name: _return(start.copy().fly(actions), gamma) for name, actions in flights.items()}
    actions = tuple(step.action for step in flight.path)
    return MapAudit(start.seed, solution.score, flight.score, actions, maximum, returns)


def audit_maps(
    task: TaskConfig, seeds: range, reward_profile: RewardProfile, gamma: float, jobs: int | None = None
) -> Iterator[MapAudit]:
    """The audits of these maps in order, `jobs` at a time: as many as the machine has cores if None."""
    one = partial(audit_map, task, reward_profile=reward_profile, gamma=gamma)
    with ThreadPoolExecutor(jobs or os.cpu_count()) as pool:
        yield one(seeds[0])  # alone: it compiles what the others then use
        yield from pool.map(one, seeds[1:])


def summarise_audits(
    task: TaskConfig, reward_profile: RewardProfile, gamma: float, audits: Sequence[MapAudit]
) -> dict[str, Any]:
    """The report over audits of neighbouring maps, as JSON values."""

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
    audit_kernel(tables, rewards, gamma, noise, grid, state, parcels, start.steps, lowest, sizes, values, lows, choices)

    flight = start.copy()

    def act(_: Observation) -> int:
        t = flight.steps - start.steps
        return int(choices[(t, flight.battery_units - lowest[t], *_aim(flight), flight.cell)])

    return rollout(flight, act), float(values[(0, start.battery_units - lowest[0], *_aim(start), start.cell)])


def _aim(flight: Episode) -> tuple[int, int]:
    """(delivered set, number of the target) of an episode that began with all parcels waiting."""
    delivered = sum(done << i for i, (_, _, done) in enumerate(flight.parcels))
    return delivered, [(x, y) for x, y, _ in flight.parcels].index(flight.target or (-1, -1))


def _return(flight: Episode, gamma: float) -> float:
    """The discounted sum of what a flight was paid."""
    return sum(reward * gamma**t for t, reward in enumerate(flight.rewards))


def repeat(action: Action, start: Episode, solution: Solution) -> tuple[Action, ...]:
    """The same action until the end."""
    return (action,) * start.task.max_steps


def oscillate(start: Episode, solution: Solution) -> tuple[Action, ...]:
    """Fly to a neighbouring cell and back until the end."""
    back = {Action.UP: Action.DOWN, Action.LEFT: Action.RIGHT, Action.DOWN: Action.UP, Action.RIGHT: Action.LEFT}
    there = next((action for action in back if start.action_mask()[action]), None)
    if there is None:
        return repeat(Action.WAIT, start, solution)
    steps = start.task.max_steps
    return (there, back[there]) * (steps // 2) + (there,) * (steps % 2)


def hover(start: Episode, solution: Solution) -> tuple[Action, ...]:
    """Fly the best flight, but wait before the last delivery for as long as it can still be made."""
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


HACKS = {
    "stall": partial(repeat, Action.WAIT),  # at the start
    "bump": partial(repeat, Action.UP),  # up to the edge of the city, and into it
    "oscillate": oscillate,
    "hover": hover,
}
"""Flights that earn without working. A new one is one more entry."""
