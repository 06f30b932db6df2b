"""Lessons for a tour network: states of flights, with the exact value of each of their options.

The values are those of `planning.legs`. Flights begin at the start of a map or anywhere on it; they follow the best
options and at times others. A choice that would lose the mission is labelled but not flown, so flights stay where
decisions matter. Which states are drawn depends on the seeds of the maps alone: not on the network that learns.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable  # pyright: ignore

from drone_env.agents.tour_view import (
    Distances,
    View,
    find_distances,
    make_distances,
    make_view,
    write_view,
)
from drone_env.core import compiled
from drone_env.core.actions import FLYING, Action
from drone_env.core.cells import DELIVERY_CELL, PAD_CELL
from drone_env.core.compile_cache import compiled_once
from drone_env.core.episode import Episode
from drone_env.core.rewards import Rewards, tabulate_rewards
from drone_env.core.rules import choose_target, reset, step
from drone_env.core.seeds import GOLDEN, mix64, next_key, uniform_below
from drone_env.core.tables import BATTERY, CELL, OUTCOME, PARCELS, STEPS, UNDER, Tables, state_size, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.planning.legs import Legs, make_legs, mark_delivered, row_after, row_of, value_kernel, working_memory
from drone_env.planning.paths import NO_STOP
from drone_env.planning.paths import ParetoPaths as Ways
from drone_env.planning.paths import Workspace as Rounds
from drone_env.planning.paths import find_paths as find_ways
from drone_env.planning.solver import ranked_scores
from drone_env.planning.states import UNPAID, delivered_set, put_drone, put_parcels, state_arrays

WAIT = int(Action.WAIT)
COMPLETE = 0.8 - 1e-9
"""Values from here on are those of whole missions. (On a uniform task of more than 8 parcels, where battery and time do
not end together, those of others can be as high.)"""
FROM_START, OTHER, NEARLY_BEST, GOES_ON = 40, 35, 20, 85
"""In percent: flights that begin at the start; choices that are not the best; those of them that cost at most `NEAR`;
how often a flight goes on along its way instead of choosing anew."""
NEAR = 0.02
KEPT_BEGUN, KEPT_ON_THE_WAY, KEPT_LOST = 75, 20, 20
"""In percent, the states that are kept: where a way begins, on the way, and once the mission cannot be completed."""


class World(NamedTuple):
    """What the maps of a task are drawn into."""

    tables: Tables
    rewards: Rewards
    grid: Any
    """uint8[cells]"""
    state: Any
    """uint16[state size]"""
    parcels: Any
    """int64[deliveries], the entries of `state` that hold the parcels."""


def place_stops(world: World, legs: Legs) -> None:
    """Write the map that stands in the world, without its drone, into the legs."""
    for cell in range(world.tables.cells):
        legs.stop_at[cell] = NO_STOP
        legs.ground[cell] = world.grid[cell]
    stop = legs.parcels
    for cell in range(world.tables.cells):
        if stop < len(legs.stops) and world.grid[cell] == PAD_CELL:
            legs.stops[stop] = cell
            stop += 1
    for i in range(legs.parcels):
        legs.stops[i] = world.state[PARCELS + i]
    for i in range(len(legs.stops)):
        legs.stop_at[legs.stops[i]] = i


def option_row(legs: Legs, delivered: int, done: int, view: View, option: int, units: int) -> int:
    """The row of `legs.ranks` that an option leads to, `view.numbers[option, 1]` steps later."""
    stop, drained = view.token[option] - 1, view.numbers[option, 0]
    after = units - drained if legs.counts else 1
    if drained < 0:
        return row_of(legs, delivered, stop, after)
    return row_after(legs, delivered, done, stop, after)


def find_option(view: View, m: int, token: int, units: int, steps: int) -> int:
    """The option of state m that leads to a token by a way of these units and steps; -1 if there is none."""
    for option in range(view.begins[m], view.begins[m + 1]):
        if view.token[option] == token and view.numbers[option, 0] == units and view.numbers[option, 1] == steps:
            return option
    return -1


def take_off(world: World, counts: int, start: int, key: int) -> tuple[int, bool]:
    """Begin a flight at the start of the map, or anywhere on it, and return the next key and whether it could.

    Args:
        world: The map, without the drone; receives the state.
        counts: 1 if units count beside steps.
        start: Where the map's flights start.
        key: What is drawn from.
    """
    tables, _, grid, state, parcels = world
    delivered, cell, units, left = 0, start, tables.capacity, tables.max_steps
    key = next_key(key)
    if uniform_below(key, 100) >= FROM_START:
        longest = tables.max_steps if counts else min(tables.capacity, tables.max_steps)
        key = next_key(key)
        delivered = uniform_below(key, (1 << len(parcels)) - 1)
        key = next_key(key)
        cell = uniform_below(key, tables.cells)
        key = next_key(key)
        flown = uniform_below(key, longest * 3 // 4)
        left = tables.max_steps - flown
        key = next_key(key)
        units = 1 + uniform_below(key, tables.capacity) if counts else tables.capacity - flown
    put_parcels(tables, grid, state, parcels, delivered)
    if grid[cell] == DELIVERY_CELL or tables.impassable[grid[cell]]:
        return key, False
    put_drone(tables, grid, state, cell, tables.max_steps - left, units)
    choose_target(tables, state)
    return key, True


for function in (place_stops, option_row, find_option, take_off):
    register_jitable(**compiled.OPTIONS)(function)


@compiled_once(nogil=True, **compiled.OPTIONS)
def lesson_kernel(
    world: World,
    legs: Legs,
    scores: Any,
    distances: Distances,
    ways: Ways,
    rounds: Rounds,
    seeds: Any,
    per_map: int,
    view: View,
    values: Any,
) -> int:
    """Draw up to `per_map` states of each map.

    Args:
        world: Working memory.
        legs: Working memory; its ends are those of a whole episode.
        scores: float64[ranks], the score of each rank.
        distances: Working memory.
        ways: Working memory.
        rounds: Working memory.
        seeds: int64[maps]
        per_map: States of each map.
        view: Receives the states.
        values: float32[options], receives the value of each option.

    Returns:
        How many states there are.
    """
    tables, rewards, grid, state, parcels = world
    m, n = 0, legs.parcels
    view.begins[0] = 0
    for seed in seeds:
        reset(tables, grid, state, seed)
        start = state[CELL] * 1
        grid[start] = state[UNDER]
        place_stops(world, legs)
        mark_delivered(legs, (1 << n) - 1)
        find_distances(tables, legs.ground, legs.stops, legs.counts, legs.stop_at, distances, ways, rounds)
        value_kernel(legs, ways, rounds)
        key, wanted = mix64(seed ^ GOLDEN), m + per_map
        for _ in range(4 * per_map):
            if m == wanted:
                break
            key, flies = take_off(world, legs.counts, start, key)
            if not flies:
                continue
            chosen_token, way_units, way_steps = -1, 0, 0
            while state[OUTCOME] == FLYING and m < wanted:
                delivered = delivered_set(state, parcels)
                cell, units, left = state[CELL] * 1, state[BATTERY] * 1, tables.max_steps - state[STEPS]
                still = left if legs.counts else min(left, units)
                done = mark_delivered(legs, delivered)
                find_ways(tables, legs.ground, cell, units, legs.counts, legs.stop_at, ways, 0, rounds)
                write_view(tables, legs.stops, n, delivered, cell, units, left, legs.counts, distances, ways, view, m)
                first, behind = view.begins[m], view.begins[m + 1]
                best, lost, alike = -1, 0, True
                for option in range(first, behind):
                    row = option_row(legs, delivered, done, view, option, units)
                    values[option] = scores[legs.ranks[row, still - view.numbers[option, 1]]]
                    alike &= values[option] == values[first]
                    lost += values[option] < COMPLETE
                    if best < 0 or values[option] > values[best]:
                        best = option
                if best < 0:
                    break
                key = next_key(key)
                drawn = uniform_below(key, 200)
                chosen = find_option(view, m, chosen_token, way_units, way_steps)
                keep = KEPT_ON_THE_WAY if chosen >= 0 else KEPT_BEGUN
                if values[best] < COMPLETE:
                    chosen, keep = best, KEPT_LOST
                elif lost == 0:
                    keep //= 2
                if chosen < 0:
                    chosen = best
                    key = next_key(key)
                    other = uniform_below(key, 100)
                    allowed = 0.0 if other >= OTHER else NEAR if other < NEARLY_BEST else 1.0
                    for _ in range(8):
                        key = next_key(key)
                        option = first + uniform_below(key, behind - first)
                        if values[option] >= max(COMPLETE, values[best] - allowed):
                            chosen = option
                            break
                action, before = view.numbers[chosen, 2], units
                chosen_token, way_units, way_steps = (
                    view.token[chosen],
                    view.numbers[chosen, 0],
                    view.numbers[chosen, 1],
                )
                if not alike and drawn < 2 * keep:
                    m += 1
                step(tables, rewards, grid, state, action)
                key = next_key(key)
                way_units -= before - state[BATTERY] if legs.counts else 1
                way_steps -= 1
                if action == WAIT or uniform_below(key, 100) >= GOES_ON:
                    chosen_token = -1
            grid[state[CELL]] = state[UNDER]
    return m


class Lessons(NamedTuple):
    """States of one task and what they teach."""

    view: View
    values: npt.NDArray[np.float32]
    """float32[options], the highest score that can still be reached after each."""


class Teacher:
    """Draws lessons on one task.

    Args:
        task: The task.
        maps: How many maps a chunk of lessons is drawn from.
        per_map: States of each.

    Raises:
        UnsupportedTaskError: if `planning.legs` does not cover the task.
        TooLargeError: if the values of a map would take too much memory.
    """

    def __init__(self, task: TaskConfig, maps: int, per_map: int) -> None:
        self.task, self._per_map = task, per_map
        tables = tabulate(task)
        self._scores, _ = ranked_scores(task)
        # Every map has as many stops as this one.
        ground, state, entries = state_arrays(Episode(task, seed=0))
        self._legs = make_legs(task, ground, state[entries].tolist(), 0, tables.capacity, tables.max_steps)
        stops = len(self._legs.stops)
        self._ways, self._rounds = working_memory(task, self._legs)
        self._distances = make_distances(stops)
        self._world = World(
            tables,
            tabulate_rewards(task, UNPAID),
            np.zeros(tables.cells, np.uint8),
            np.zeros(state_size(tables), np.uint16),
            entries,
        )
        states = maps * per_map + 1
        room = states * stops * self._ways.units.shape[1]
        self._view, self._values = make_view(states, stops, room), np.zeros(room, np.float32)

    def draw(self, seeds: npt.NDArray[np.int64]) -> Lessons:
        """The lessons of these maps."""
        view = self._view
        m = lesson_kernel(
            self._world,
            self._legs,
            self._scores,
            self._distances,
            self._ways,
            self._rounds,
            seeds,
            self._per_map,
            view,
            self._values,
        )
        options = int(view.begins[m])
        drawn = View(
            view.tokens[:m].copy(), view.present[:m].copy(), view.edges[:m].copy(), view.begins[: m + 1].copy(),
            view.token[:options].copy(), view.features[:options].copy(), view.numbers[:options].copy(),
        )  # fmt: skip
        return Lessons(drawn, self._values[:options].copy())
