"""The rules of the world: `reset` writes the first state of a map, `step` flies one action and returns its reward.

`write_telemetry` and `open_actions` write what an agent observes; the caller owns the buffers.

These functions run as plain Python for one episode (`episode.Episode`) and compiled by Numba (`compiled`), with equal
results to the last bit. `tables` documents the state, and the tables of a task.
"""

from typing import TypedDict

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import FLYING, N_ACTIONS, Event, Outcome
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, DRONE_CELL
from drone_env.core.grid_generator import scatter
from drone_env.core.rewards import STRIDE, Rewards
from drone_env.core.tables import (
    BATTERY,
    CELL,
    DELIVERED_FLAG,
    DELIVERIES_DONE,
    DISTANCE,
    EVENT,
    N_MOVES,
    N_TERRAIN,
    NOWHERE,
    OUTCOME,
    PARCELS,
    STEPS,
    TARGET,
    UNDER,
    Buffer,
    FloatBuffer,
    Tables,
)

# Plain integers, because compiled code cannot use enum members.
DELIVERY, BATTERY_EMPTY = int(Event.DELIVERY), int(Event.BATTERY_DEAD)
WALL, BLOCKED, NONE = int(Event.WALL), int(Event.BLOCKED), int(Event.NONE)
DELIVERED, BATTERY_DEAD = int(Outcome.DELIVERED), int(Outcome.BATTERY_DEAD)
OUT_OF_STEPS = int(Outcome.OUT_OF_STEPS)

DELTA_BITS = 3
"""A mask that does not change numbers from 0 to 2. It shows the compiler that they are not negative."""
LOWEST, HIGHEST = 0.01, 0.99
"""Bounds of the graded score."""
EFFICIENCY_WEIGHTS = {"parcels delivered": 75, "battery left": 15, "steps left": 10}
"""Percentages of the efficiency, a number for people that no reward contains."""


def reset(tables: Tables, grid: Buffer, state: Buffer, seed: int) -> None:
    """Write the first state of map `seed`: full battery, no step taken, nothing delivered."""
    scatter(tables, grid, state, seed)
    state[STEPS] = 0
    state[BATTERY] = tables.capacity
    state[DELIVERIES_DONE] = 0
    state[EVENT] = NONE
    state[OUTCOME] = FLYING
    choose_target(tables, state)


def step(tables: Tables, rewards: Rewards, grid: Buffer, state: Buffer, action: int) -> float:
    """Fly one action and return its reward. After the end of the episode, change nothing and return 0."""
    if state[OUTCOME] != FLYING:
        return 0.0
    potential = potential_of(rewards.potential, state)

    # Move: at the edge of the grid or at an impassable cell, the drone stays.
    cell, under, steps = state[CELL], state[UNDER], state[STEPS] + 1
    to = tables.moves[cell * N_ACTIONS + action]
    event = collision(tables, grid, to)
    if event == NONE:
        under = move(grid, state, cell, to)
        cell = to
        event = tables.flight_event[under * N_ACTIONS + action]
    distance = manhattan(tables, cell, state[TARGET])

    # Drain: by the action and the kind of cell below the drone; a pad charges.
    battery = units_left(tables, state[BATTERY], tables.drain[under * N_ACTIONS + action])
    state[BATTERY] = battery
    delta = (1 + state[DISTANCE] - distance) & DELTA_BITS
    state[STEPS] = steps
    state[DISTANCE] = distance

    # Deliver the parcel on this cell, in any order, and end the episode if it is over.
    if under == DELIVERY_CELL:
        deliver(tables, state)
        event = DELIVERY
        state[OUTCOME] = outcome(tables, state[DELIVERIES_DONE], battery, steps)
    elif battery == 0 or steps == tables.max_steps:
        state[OUTCOME] = outcome(tables, state[DELIVERIES_DONE], battery, steps)
        if state[OUTCOME] == BATTERY_DEAD:
            event = BATTERY_EMPTY
    state[EVENT] = event

    # Reward: for the event, and for the distance to the target that was current before the step.
    return reward_of(tables, rewards, state, event, delta, potential)


def collision(tables: Tables, grid: Buffer, to: int) -> int:
    """`Event.WALL` or `Event.BLOCKED` if the drone cannot enter the cell `to`, else `Event.NONE`."""
    if to == NOWHERE:
        return WALL
    if tables.any_impassable and tables.impassable[grid[to]]:
        return BLOCKED
    return NONE


def move(grid: Buffer, state: Buffer, cell: int, to: int) -> int:
    """Uncover the cell that the drone leaves, cover the one that it reaches, and return its kind."""
    grid[cell] = state[UNDER]
    under = grid[to]
    state[CELL] = to
    state[UNDER] = under
    grid[to] = DRONE_CELL
    return under


def manhattan(tables: Tables, a: int, b: int) -> int:
    """Manhattan distance between two cells."""
    return abs(tables.columns[a] - tables.columns[b]) + abs(tables.rows[a] - tables.rows[b])


def units_left(tables: Tables, units: int, drain: int) -> int:
    """Battery units after a drain (a negative drain charges), from 0 to capacity."""
    return min(max(units - drain, 0), tables.capacity)


def deliver(tables: Tables, state: Buffer) -> None:
    """Deliver the parcel on the drone's cell; if it was the target, choose the next one."""
    state[UNDER] = DELIVERED_CELL
    state[DELIVERIES_DONE] += 1
    for i in range(PARCELS, PARCELS + tables.deliveries):
        if state[i] == state[CELL]:
            state[i] += DELIVERED_FLAG
    if state[TARGET] == state[CELL]:
        choose_target(tables, state)


def choose_target(tables: Tables, state: Buffer) -> None:
    """Make the nearest undelivered parcel the current target. Ties go to the lowest index."""
    state[TARGET] = NOWHERE
    state[DISTANCE] = 0
    for i in range(PARCELS, PARCELS + tables.deliveries):
        if state[i] < DELIVERED_FLAG:
            distance = manhattan(tables, state[CELL], state[i])
            if state[TARGET] == NOWHERE or distance < state[DISTANCE]:
                state[TARGET] = state[i]
                state[DISTANCE] = distance


def outcome(tables: Tables, deliveries: int, battery: int, steps: int) -> int:
    """The outcome of an episode after a step with these parcels delivered, battery units left and steps taken."""
    if deliveries == tables.deliveries:
        return DELIVERED
    if battery == 0:
        return BATTERY_DEAD
    if steps == tables.max_steps:
        return OUT_OF_STEPS
    return FLYING


def reward_of(
    tables: Tables, rewards: Rewards, state: Buffer, event: int, delta: int, potential_before: float
) -> float:
    """The reward of the step that led to `state`.

    Args:
        tables: The task's tables.
        rewards: The profile's tables.
        state: The state after the step, with its outcome.
        event: The event of the step.
        delta: 2 if the distance to the target before the step decreased, 1 if it is equal, else 0.
        potential_before: The potential of the state before the step.
    """
    reward = rewards.events[event * 3 + delta] - potential_before
    if state[OUTCOME] == FLYING:
        return reward + potential_of(rewards.discounted, state)
    if rewards.pays_score:
        return reward + score(tables, state)
    return reward


def potential_of(table: FloatBuffer, state: Buffer) -> float:
    """The entry for the state in a table of a profile, `potential` or `discounted`."""
    return table[state[DELIVERIES_DONE] * STRIDE + state[DISTANCE]]


def score_of(tables: Tables, deliveries_done: int, battery: int, steps: int) -> float:
    """0.8 * done/total + 0.2 * (0.5 * battery/capacity + 0.5 * (1 - steps/max_steps)), in [0.01, 0.99].

    With `efficiency_needs_all` the second term counts only if everything is delivered. The score is one correctly
    rounded division of integers, so equal flights have equal scores to the last bit.
    """
    total, capacity, max_steps = tables.deliveries, tables.capacity, tables.max_steps
    needs_all = tables.efficiency_needs_all  # read here: inside the condition it costs a compiled step 4 %
    tenths = 8 * deliveries_done * capacity * max_steps
    if deliveries_done == total or not needs_all:
        tenths += total * (battery * max_steps + (max_steps - steps) * capacity)
    return min(max(tenths / (10 * total * capacity * max_steps), LOWEST), HIGHEST)


def score(tables: Tables, state: Buffer) -> float:
    """The graded score of the episode: provisional until it has ended."""
    return score_of(tables, state[DELIVERIES_DONE], state[BATTERY], state[STEPS])


class Observation(TypedDict):
    """The observation of an agent."""

    grid: npt.NDArray[np.uint8]
    """uint8[height, width] of cell ids; the drone's id hides the cell below it."""
    telemetry: npt.NDArray[np.float32]
    """float32[5], [6] or [13]: see `write_telemetry`."""


def write_telemetry(tables: Tables, state: Buffer, telemetry: FloatBuffer) -> None:
    """Write drone x/width, y/height, battery/capacity, target x/width, y/height into float32[5].

    If nothing is left to deliver, the target is the drone's own position. A sixth value is the fraction of steps left,
    if the battery does not show it. Tasks with pads have this value, and then seven more: the one-hot kind of the cell
    below the drone, in the order of `tasks.TERRAIN`.
    """
    write_own_telemetry(tables, state, telemetry)
    write_target_telemetry(tables, state, telemetry)


def write_own_telemetry(tables: Tables, state: Buffer, telemetry: FloatBuffer) -> None:
    """Write the part that every step changes: position, battery, steps left, the cell below."""
    at = 2 * state[CELL]
    x, y, battery = tables.shares[at], tables.shares[at + 1], tables.battery_share[state[BATTERY]]
    telemetry[0], telemetry[1], telemetry[2] = x, y, battery
    if tables.telemetry_size > 5:
        telemetry[5] = tables.steps_share[state[STEPS]]
    if tables.telemetry_size > 6:
        for i in range(6, 6 + N_TERRAIN):
            telemetry[i] = 0.0
        telemetry[6 + tables.terrain_numbers[state[UNDER]]] = 1.0


def write_target_telemetry(tables: Tables, state: Buffer, telemetry: FloatBuffer) -> None:
    """Write the part that only a delivery or a reset changes: the target."""
    target = state[TARGET] if state[TARGET] != NOWHERE else state[CELL]
    telemetry[3], telemetry[4] = tables.shares[2 * target], tables.shares[2 * target + 1]


def open_actions(tables: Tables, grid: Buffer, state: Buffer) -> int:
    """The actions that do not bump, as an integer with 1 in byte `action`. Not enforced."""
    mask = tables.open_moves[state[CELL]]
    if tables.any_impassable:
        for action in range(N_MOVES):
            mask -= tables.impassable[grid[tables.around[state[CELL] * N_MOVES + action]]] << 8 * action
    return mask
