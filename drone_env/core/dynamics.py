"""The rules of the world: `reset` makes the first state of an episode, `step` turns state and action into the next.

These functions, and the ones that they call, are the only place where the rules stand. They run as plain Python for a
single episode (`state_manager.Episode`) and compiled by Numba (`compiled`), with the same bits as a result.
"""

from drone_env.core.actions import N_ACTIONS, Event, Outcome
from drone_env.core.cells import Cell
from drone_env.core.drone import distance, place, use_battery
from drone_env.core.grid_generator import scatter
from drone_env.core.obstacles import collision, terrain_event
from drone_env.core.rewards import Rewards, reward_of
from drone_env.core.rules import (
    BATTERY,
    CELL,
    DELIVERIES,
    DISTANCE,
    EVENT,
    OUTCOME,
    PARCELS,
    STEPS,
    TARGET,
    UNDER,
    Buffer,
    Rules,
)

DELIVERY_CELL = int(Cell.DELIVERY)
DELIVERED_CELL = int(Cell.DELIVERED)

DELIVERY = int(Event.DELIVERY)
DEAD = int(Event.BATTERY_DEAD)
WAITED = int(Event.WAIT)
STEPPED = int(Event.STEP)
NONE = int(Event.NONE)

FLYING = int(Outcome.FLYING)
DELIVERED = int(Outcome.DELIVERED)
BATTERY_DEAD = int(Outcome.BATTERY_DEAD)
OUT_OF_STEPS = int(Outcome.OUT_OF_STEPS)

WAIT = N_ACTIONS - 1


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
    deliveries_before = row[DELIVERIES]
    target_before = row[TARGET]
    distance_before = row[DISTANCE]

    bump = collision(rules, grid, row, action)
    if bump == NONE:
        place(grid, row, rules.moves[row[CELL] * N_ACTIONS + action])
    row[STEPS] += 1
    use_battery(rules, row, action)
    deliver(rules, row)
    row[DISTANCE] = distance(rules, row[CELL], target_before)
    closer = distance_before - row[DISTANCE]
    if row[CELL] == target_before:
        choose_target(rules, row)
    row[OUTCOME] = outcome(rules, row)
    row[EVENT] = event(rules, row, action, bump, deliveries_before)
    return reward_of(rules, rewards, row, closer, deliveries_before, distance_before)


def deliver(rules: Rules, row: Buffer) -> None:
    """Deliver the parcel that waits for the drone on its cell, if there is one."""
    if row[UNDER] != DELIVERY_CELL:
        return
    row[UNDER] = DELIVERED_CELL
    row[DELIVERIES] += 1
    for i in range(PARCELS, PARCELS + rules.deliveries):
        if row[i] == row[CELL]:
            row[i] = ~row[i]


def choose_target(rules: Rules, row: Buffer) -> None:
    """Make the nearest undelivered parcel the current target (the first of equally near ones)."""
    row[TARGET] = -1
    row[DISTANCE] = 0
    for i in range(PARCELS, PARCELS + rules.deliveries):
        if row[i] >= 0:
            far = distance(rules, row[CELL], row[i])
            if row[TARGET] < 0 or far < row[DISTANCE]:
                row[TARGET] = row[i]
                row[DISTANCE] = far


def outcome(rules: Rules, row: Buffer) -> int:
    """How the episode stands after a step."""
    if row[DELIVERIES] == rules.deliveries:
        return DELIVERED
    if row[BATTERY] == 0:
        return BATTERY_DEAD
    if row[STEPS] == rules.max_steps:
        return OUT_OF_STEPS
    return FLYING


def event(rules: Rules, row: Buffer, action: int, bump: int, deliveries_before: int) -> int:
    """What the step came to: the first of the events in `Event` that holds."""
    if row[DELIVERIES] > deliveries_before:
        return DELIVERY
    if row[OUTCOME] == BATTERY_DEAD:
        return DEAD
    if bump != NONE:
        return bump
    terrain = terrain_event(rules, row)
    if terrain != STEPPED:
        return terrain
    return WAITED if action == WAIT else STEPPED
