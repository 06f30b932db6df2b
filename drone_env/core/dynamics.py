"""The rules of the world: `reset` makes the first state of an episode, `step` turns state and action into the next.

These functions, and the ones that they call, are the only place where the rules stand. They run as plain Python for a
single episode (`state_manager.Episode`) and compiled by Numba (`compiled`), with the same bits as a result.
"""

from drone_env.core.actions import N_ACTIONS, Event, Outcome
from drone_env.core.cells import Cell
from drone_env.core.drone import distance, move, use_battery
from drone_env.core.grid_generator import scatter
from drone_env.core.obstacles import collision, flight_event
from drone_env.core.rewards import Rewards, potential_of, reward_of
from drone_env.core.rules import (
    BATTERY,
    CELL,
    DELIVERED_FLAG,
    DELIVERIES,
    DISTANCE,
    EVENT,
    NOWHERE,
    OUTCOME,
    PARCELS,
    STEPS,
    TARGET,
    UNDER,
    Buffer,
    Rules,
)

CLOSER_BITS = 3
"""Changes nothing from 0 to 2, and tells the compiler that none is below zero."""

DELIVERY_CELL = int(Cell.DELIVERY)
DELIVERED_CELL = int(Cell.DELIVERED)

DELIVERY = int(Event.DELIVERY)
DEAD = int(Event.BATTERY_DEAD)
NONE = int(Event.NONE)

FLYING = int(Outcome.FLYING)
DELIVERED = int(Outcome.DELIVERED)
BATTERY_DEAD = int(Outcome.BATTERY_DEAD)
OUT_OF_STEPS = int(Outcome.OUT_OF_STEPS)


def reset(rules: Rules, grid: Buffer, row: Buffer, seed: int) -> None:
    """Write the first state of map `seed`."""
    scatter(rules, grid, row, seed)
    begin(rules, row)


def begin(rules: Rules, row: Buffer) -> None:
    """Full battery, no step taken, nothing delivered, on the map that stands in the state."""
    row[STEPS] = 0
    row[BATTERY] = rules.capacity
    row[DELIVERIES] = 0
    row[EVENT] = NONE
    row[OUTCOME] = FLYING
    choose_target(rules, row)


def step(rules: Rules, rewards: Rewards, grid: Buffer, row: Buffer, action: int) -> float:
    """Fly one action and return its reward. After the end of the episode it changes nothing and pays 0."""
    if row[OUTCOME] != FLYING:
        return 0.0
    potential = potential_of(rewards.potential, row)

    cell, under, steps = row[CELL], row[UNDER], row[STEPS] + 1
    to = rules.moves[cell * N_ACTIONS + action]
    happened = collision(rules, grid, to)
    if happened == NONE:
        under = move(grid, row, cell, to)
        cell = to
        happened = flight_event(rules, under, action)
    far = distance(rules, cell, row[TARGET])
    battery = use_battery(rules, row, under, action)
    closer = (1 + row[DISTANCE] - far) & CLOSER_BITS
    row[STEPS] = steps
    row[DISTANCE] = far
    if under == DELIVERY_CELL:
        deliver(rules, row)
        happened = DELIVERY
        if far == 0:
            choose_target(rules, row)
        row[OUTCOME] = outcome(rules, row)
    elif battery == 0 or steps == rules.max_steps:
        row[OUTCOME] = outcome(rules, row)
        if row[OUTCOME] == BATTERY_DEAD:
            happened = DEAD
    row[EVENT] = happened
    return reward_of(rules, rewards, row, happened, closer, potential)


def deliver(rules: Rules, row: Buffer) -> None:
    """Deliver the parcel that waits for the drone on its cell."""
    row[UNDER] = DELIVERED_CELL
    row[DELIVERIES] += 1
    for i in range(PARCELS, PARCELS + rules.deliveries):
        if row[i] == row[CELL]:
            row[i] += DELIVERED_FLAG


def choose_target(rules: Rules, row: Buffer) -> None:
    """Make the nearest undelivered parcel the current target (the first of equally near ones)."""
    row[TARGET] = NOWHERE
    row[DISTANCE] = 0
    for i in range(PARCELS, PARCELS + rules.deliveries):
        if row[i] < DELIVERED_FLAG:
            far = distance(rules, row[CELL], row[i])
            if row[TARGET] == NOWHERE or far < row[DISTANCE]:
                row[TARGET] = row[i]
                row[DISTANCE] = far


def outcome(rules: Rules, row: Buffer) -> int:
    """How the episode stands after a step."""
    return outcome_of(rules, row[DELIVERIES], row[BATTERY], row[STEPS])


def outcome_of(rules: Rules, deliveries: int, battery: int, steps: int) -> int:
    """The same, of the three numbers that decide it."""
    if deliveries == rules.deliveries:
        return DELIVERED
    if battery == 0:
        return BATTERY_DEAD
    if steps == rules.max_steps:
        return OUT_OF_STEPS
    return FLYING
