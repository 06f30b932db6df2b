"""Dynamic programming backwards over all states of a map: the highest return of a reward, with the lowest score.

The states are (steps, battery, delivered set, current target, cell). The kernel flies the compiled `step` from every
state. Among actions with equal returns, it takes the one that leads to the lowest score.
"""

from typing import Any, NamedTuple

import numpy as np

from drone_env.core.actions import FLYING, N_ACTIONS
from drone_env.core.cells import DELIVERY_CELL
from drone_env.core.compile_cache import compiled_once
from drone_env.core.compiled import inlined, jitable
from drone_env.core.episode import Episode
from drone_env.core.rewards import RewardProfile, Rewards, tabulate_rewards
from drone_env.core.rules import manhattan, score, step
from drone_env.core.tables import (
    BATTERY,
    CELL,
    DELIVERED_FLAG,
    DELIVERIES_DONE,
    DISTANCE,
    OUTCOME,
    TARGET,
    UNDER,
    Tables,
    tabulate,
)
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


class Returns(NamedTuple):
    """A map, a reward, and the highest returns from all states of the map, for kernels.

    If the reward does not depend on the current target, there is one target instead of n.
    """

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
    """float64[steps, battery, 2^n, targets, cells], the highest returns; step t is at t modulo `steps`, T + 1 or 2."""
    lows: Any
    """float64[2, battery, 2^n, targets, cells], the lowest scores with these returns."""
    choices: Any
    """uint8[steps, battery, 2^n, targets, cells], an action with this return and score; `steps` is T or 1."""


@inlined
def fly_action(returns: Returns, t: int, units: int, delivered: int, target: int, cell: int, action: int) -> Any:
    """Fly one action from a state; return the highest return from there on, and the lowest score that it leads to."""
    tables, rewards, gamma, _, grid, state, parcels, first_step, lowest, _, values, lows, _ = returns
    under, target_cell = grid[cell], state[parcels[target]] & (DELIVERED_FLAG - 1)
    put_drone(tables, grid, state, cell, first_step + t, lowest[t] + units)
    state[TARGET] = target_cell
    state[DISTANCE] = manhattan(tables, cell, target_cell)
    before = state[DELIVERIES_DONE]
    paid = step(tables, rewards, grid, state, action)
    arrived = state[DELIVERIES_DONE] != before
    if state[OUTCOME] != FLYING:
        low = score(tables, state)
    else:
        later, left = t + 1, state[BATTERY] - lowest[t + 1]
        after, aim = delivered, target
        if arrived:
            after = delivered_set(state, parcels)
            aim = min(number_of(state, parcels, state[TARGET]), values.shape[3] - 1)
        paid += gamma * values[later % len(values), left, after, aim, state[CELL]]
        low = lows[later & 1, left, after, aim, state[CELL]]
    grid[state[CELL]] = state[UNDER]
    if arrived:
        put_parcels(tables, grid, state, parcels, delivered)
    grid[cell] = under
    return paid, low


@inlined
def choose(paid: Any, scores: Any, noise: float) -> tuple[int, float]:
    """Among the actions with the highest return, the first one with the lowest score; and that return."""
    best, largest, choice = paid[0], 0.0, -1
    for value in paid:
        best, largest = max(best, value), max(largest, abs(value))
    lowest = best - (TIE * largest + noise)
    for action in range(N_ACTIONS):
        if paid[action] >= lowest and (choice < 0 or scores[action] < scores[choice]):
            choice = action
    return choice, best


# It allocates two small arrays, so it needs reference counts.
@compiled_once(nogil=True, error_model="numpy")
def return_kernel(returns: Returns) -> None:
    """Compute the tables backwards from the last step."""
    tables, grid, values, lows, choices = returns.tables, returns.grid, returns.values, returns.lows, returns.choices
    paid, scores, targets = np.zeros(N_ACTIONS), np.zeros(N_ACTIONS), values.shape[3]
    for t in range(len(returns.sizes) - 1, -1, -1):
        for delivered in range(values.shape[2] - 1):
            put_parcels(tables, grid, returns.state, returns.parcels, delivered)
            for place in range(targets * tables.cells):
                target, cell = divmod(place, tables.cells)
                under = grid[cell]
                if (targets > 1 and delivered >> target & 1) or under == DELIVERY_CELL or tables.impassable[under]:
                    continue
                for units in range(returns.sizes[t]):
                    for action in range(N_ACTIONS):
                        paid[action], scores[action] = fly_action(returns, t, units, delivered, target, cell, action)
                    choice, best = choose(paid, scores, returns.noise)
                    values[t % len(values), units, delivered, target, cell] = best
                    lows[t & 1, units, delivered, target, cell] = scores[choice]
                    choices[t % len(choices), units, delivered, target, cell] = choice


def highest_returns(start: Episode, profile: RewardProfile, gamma: float, of_targets: bool) -> Returns:
    """Compute the highest returns from all states that an episode can reach.

    Args:
        start: The episode, in flight; it is not changed.
        profile: The reward.
        gamma: The discount.
        of_targets: Whether the reward depends on the current target. Then the tables contain the actions at each step,
            otherwise the returns at each step.

    Raises:
        TooLargeError: if the tables would take more memory than `states.MAX_BYTES`.
    """
    task = start.task
    tables, rewards, (grid, state, parcels) = tabulate(task), tabulate_rewards(task, profile), state_arrays(start)
    lowest, sizes = battery_ranges(start)
    shape = int(sizes.max()), 1 << len(parcels), len(parcels) if of_targets else 1, tables.cells
    steps, chosen = (2, len(sizes)) if of_targets else (len(lowest), 1)
    require_memory("the table of all states", task, int(np.prod(shape, dtype=object)) * (8 * steps + 16 + chosen))
    values, lows, choices = np.zeros((steps, *shape)), np.zeros((2, *shape)), np.zeros((chosen, *shape), np.uint8)
    noise = NOISE * float(max(np.abs(rewards.events).max(), np.abs(rewards.potential).max()))
    work = (start.steps, lowest, sizes, values, lows, choices)
    returns = Returns(tables, rewards, gamma, noise, grid, state, parcels, *work)
    return_kernel(returns)
    return returns
