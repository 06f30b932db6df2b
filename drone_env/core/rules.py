"""The rules of the world: `reset` makes the first state of an episode, `step` turns state and action into the next.

These functions, and the ones that they call, are the only place where the rules stand. They run as plain Python for a
single episode (`episode.Episode`) and compiled by Numba (`compiled`), with the same bits as a result.
"""

from drone_env.core.actions import FLYING, N_ACTIONS, Event, Outcome
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL
from drone_env.core.drone import distance, move, use_battery
from drone_env.core.grid_generator import scatter
from drone_env.core.obstacles import NONE, collision
from drone_env.core.rewards import Rewards, potential_of, reward_of
from drone_env.core.tables import (
    BATTERY,
    CELL,
    DELIVERED_FLAG,
    DELIVERIES_DONE,
    DISTANCE,
    EVENT,
    NOWHERE,
    OUTCOME,
    PARCELS,
    STEPS,
    TARGET,
    UNDER,
    Buffer,
    Tables,
)

CLOSER_BITS = 3
"""Changes nothing from 0 to 2, and tells the compiler that none is below zero."""

DELIVERY = int(Event.DELIVERY)
DEAD = int(Event.BATTERY_DEAD)

DELIVERED = int(Outcome.DELIVERED)
BATTERY_DEAD = int(Outcome.BATTERY_DEAD)
OUT_OF_STEPS = int(Outcome.OUT_OF_STEPS)


def reset(tables: Tables, grid: Buffer, state: Buffer, seed: int) -> None:
    """Write the first state of map `seed`."""
    scatter(tables, grid, state, seed)
    begin(tables, state)


def begin(tables: Tables, state: Buffer) -> None:
    """Full battery, no step taken, nothing delivered, on the map that stands in the state."""
    state[STEPS] = 0
    state[BATTERY] = tables.capacity
    state[DELIVERIES_DONE] = 0
    state[EVENT] = NONE
    state[OUTCOME] = FLYING
    choose_target(tables, state)


def step(tables: Tables, rewards: Rewards, grid: Buffer, state: Buffer, action: int) -> float:
    """Fly one action and return its reward. After the end of the episode it changes nothing and pays 0."""
    if state[OUTCOME] != FLYING:
        return 0.0
    potential = potential_of(rewards.potential, state)

    cell, under, steps = state[CELL], state[UNDER], state[STEPS] + 1
    to = tables.moves[cell * N_ACTIONS + action]
    happened = collision(tables, grid, to)
    if happened == NONE:
        under = move(grid, state, cell, to)
        cell = to
        happened = tables.flight_event[under * N_ACTIONS + action]
    far = distance(tables, cell, state[TARGET])
    battery = use_battery(tables, state, under, action)
    closer = (1 + state[DISTANCE] - far) & CLOSER_BITS
    state[STEPS] = steps
    state[DISTANCE] = far
    if under == DELIVERY_CELL:
        deliver(tables, state)
        happened = DELIVERY
        state[OUTCOME] = outcome(tables, state)
    elif battery == 0 or steps == tables.max_steps:
        state[OUTCOME] = outcome(tables, state)
        if state[OUTCOME] == BATTERY_DEAD:
            happened = DEAD
    state[EVENT] = happened
    return reward_of(tables, rewards, state, happened, closer, potential)


def deliver(tables: Tables, state: Buffer) -> None:
    """Deliver the parcel that waits for the drone on its cell; if that was the target, the next becomes it."""
    state[UNDER] = DELIVERED_CELL
    state[DELIVERIES_DONE] += 1
    for i in range(PARCELS, PARCELS + tables.deliveries):
        if state[i] == state[CELL]:
            state[i] += DELIVERED_FLAG
    if state[TARGET] == state[CELL]:
        choose_target(tables, state)


def choose_target(tables: Tables, state: Buffer) -> None:
    """Make the nearest undelivered parcel the current target (the first of equally near ones)."""
    state[TARGET] = NOWHERE
    state[DISTANCE] = 0
    for i in range(PARCELS, PARCELS + tables.deliveries):
        if state[i] < DELIVERED_FLAG:
            far = distance(tables, state[CELL], state[i])
            if state[TARGET] == NOWHERE or far < state[DISTANCE]:
                state[TARGET] = state[i]
                state[DISTANCE] = far


def outcome(tables: Tables, state: Buffer) -> int:
    """How the episode stands after a step."""
    return outcome_of(tables, state[DELIVERIES_DONE], state[BATTERY], state[STEPS])


def outcome_of(tables: Tables, deliveries: int, battery: int, steps: int) -> int:
    """The same, of the three numbers that decide it."""
    if deliveries == tables.deliveries:
        return DELIVERED
    if battery == 0:
        return BATTERY_DEAD
    if steps == tables.max_steps:
        return OUT_OF_STEPS
    return FLYING
