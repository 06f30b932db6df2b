"""Lessons for a tour network: states of flights with the exact value of each of their options.

The labels are those of `planning.legs`. Flights follow the best options, others at times, and begin at the start of a map or
anywhere on it. A choice that would lose the mission is labelled but not flown, and a flight ends where the mission
cannot be completed any more: states are drawn where decisions matter. What is drawn depends on the seed of the map alone.
"""

from typing import Any, NamedTuple

import numpy as np
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
from drone_env.core.actions import FLYING, N_ACTIONS, Action
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, PAD_CELL
from drone_env.core.compile_cache import compiled_once
from drone_env.core.rewards import RewardProfile, tabulate_rewards
from drone_env.core.rules import choose_target, reset, step
from drone_env.core.seeds import GOLDEN, MASK32, mix64, next_key, uniform_below, wrap64
from drone_env.core.tables import BATTERY, CELL, DELIVERED_FLAG, OUTCOME, PARCELS, STEPS, UNDER, state_size, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.planning.exact import ranked_scores
from drone_env.planning.legs import Legs, end_row, mark_delivered, row_after, row_of, value_kernel
from drone_env.planning.map_graph import delivered_set, put_drone, put_parcels
from drone_env.planning.ways import NO_STOP, counts_units, find_ways, make_rounds, make_ways

WAIT = int(Action.WAIT)
COMPLETE = 0.8 - 1e-9
"""Scores from here on are those of whole missions."""


class Keep(NamedTuple):
    """What is kept of the states of one chunk."""

    view: View
    values: Any
    """float32[options]"""


def option_rank(legs: Legs, delivered: int, done: int, view: View, option: int, units: int, left: int) -> int:
    """The rank of an option of a state."""
    stop = view.token[option] - 1
    after = units - view.numbers[option, 0] if legs.counts else 1
    left_after = left - view.numbers[option, 1]
    if view.numbers[option, 0] < 0:
        return legs.ranks[row_of(legs, delivered, stop, after), left_after]
    return legs.ranks[row_after(legs, delivered, done, stop, after), left_after]


register_jitable(**compiled.OPTIONS)(option_rank)


@compiled_once(nogil=True, **compiled.OPTIONS)
def lesson_kernel(
    tables: Any, rewards: Any, legs: Legs, scores: Any, grid: Any, state: Any, parcel_entries: Any, distances: Any,
    ways: Any, rounds: Any, seeds: Any, per_map: int, view: View, values: Any, weights: Any,
) -> int:
    """Fill `view` with states of the maps of `seeds`; returns how many."""
    m = 0
    n = legs.parcels
    view.begins[0] = 0
    for seed in seeds:
        reset(tables, grid, state, seed)
        grid[state[CELL]] = state[UNDER]
        start = state[CELL] * 1
        for cell in range(tables.cells):
            legs.stop_at[cell] = NO_STOP
            legs.ground[cell] = grid[cell]
        for i in range(n):
            legs.stops[i] = state[PARCELS + i]
        pad = n
        for cell in range(tables.cells):
            if pad < len(legs.stops) and grid[cell] == PAD_CELL:
                legs.stops[pad] = cell
                pad += 1
        for i in range(len(legs.stops)):
            legs.stop_at[legs.stops[i]] = i
        mark_delivered(legs, (1 << n) - 1)
        find_distances(tables, legs.ground, legs.stops, legs.counts, legs.stop_at, distances, ways, rounds)
        value_kernel(legs, ways, rounds)
        key = mix64(seed ^ GOLDEN)
        kept = 0
        for flight in range(per_map * 4):
            if kept >= per_map:
                break
            # Begin at the start of the map, or anywhere.
            key = next_key(key)
            delivered, cell, units, left = 0, start, tables.capacity, tables.max_steps
            if uniform_below(key, 5) > 1:
                key = next_key(key)
                delivered = uniform_below(key, (1 << n) - 1)
                key = next_key(key)
                cell = uniform_below(key, tables.cells)
                key = next_key(key)
                left = tables.max_steps - uniform_below(key, tables.max_steps * 3 // 4)
                key = next_key(key)
                units = 1 + uniform_below(key, tables.capacity) if legs.counts else left
            put_parcels(tables, grid, state, parcel_entries, delivered)
            if grid[cell] == DELIVERY_CELL or tables.impassable[grid[cell]]:
                continue
            put_drone(tables, grid, state, cell, tables.max_steps - left, units)
            choose_target(tables, state)
            target, target_units, target_steps = -1, 0, 0
            while state[OUTCOME] == FLYING and kept < per_map:
                delivered = delivered_set(state, parcel_entries)
                cell, units, left = state[CELL] * 1, state[BATTERY] * 1, tables.max_steps - state[STEPS]
                done = mark_delivered(legs, delivered)
                find_ways(tables, legs.ground, cell, units, legs.counts, legs.stop_at, ways, 0, rounds)
                write_view(
                    tables, legs.stops, n, delivered, cell, units, left, legs.counts, distances, ways, view, m
                )
                first, behind = view.begins[m], view.begins[m + 1]
                best, lost = -1, 0
                for option in range(first, behind):
                    values[option] = scores[option_rank(legs, delivered, done, view, option, units, left)]
                    if best < 0 or values[option] > values[best]:
                        best = option
                    lost += values[option] < COMPLETE
                if best < 0 or values[best] < COMPLETE:
                    break
                chosen = -1
                if target >= 0:
                    for option in range(first, behind):
                        if (
                            view.token[option] == target
                            and view.numbers[option, 0] == target_units
                            and view.numbers[option, 1] == target_steps
                        ):
                            chosen = option
                begun = chosen < 0
                if begun:
                    key = next_key(key)
                    chosen = best
                    u = uniform_below(key, 100)
                    if u < 35:
                        allowed = 0.02 if u < 20 else 1.0
                        for tries in range(8):
                            key = next_key(key)
                            option = first + uniform_below(key, behind - first)
                            if values[option] >= COMPLETE and values[option] >= values[best] - allowed:
                                chosen = option
                                break
                key = next_key(key)
                wanted = uniform_below(key, 100)
                if behind - first > 1 and (lost > 0 or wanted % 2) and wanted < (75 if begun else 20):
                    m += 1
                    kept += 1
                action = view.numbers[chosen, 2]
                units_before = state[BATTERY] * 1
                step(tables, rewards, grid, state, action)
                # Goes on along this way, or chooses anew.
                key = next_key(key)
                target = -1
                if action != WAIT and uniform_below(key, 100) < 85:
                    target = view.token[chosen]
                    drained = units_before - state[BATTERY]
                    target_units = view.numbers[chosen, 0] - drained
                    target_steps = view.numbers[chosen, 1] - 1
            grid[state[CELL]] = state[UNDER]
    return m


class Teacher:
    """Draws lessons on one task."""

    def __init__(self, task: TaskConfig, maps: int = 16, per_map: int = 64) -> None:
        self.task, self.maps, self.per_map = task, maps, per_map
        self.tables = tabulate(task)
        scores, ranked = ranked_scores(task)
        counts = counts_units(task)
        n = task.deliveries
        pads = task.pads if counts and task.charge_rate else 0
        stops = n + pads
        most = task.battery_capacity if counts else 1
        t = task.max_steps
        ends = np.empty((n + 1, most + 1, t + 1), ranked.dtype)
        if counts:
            ends[:n] = ranked[:n, 0, t][:, None, None]
            ends[n] = ranked[n, :, ::-1]
        else:
            m = min(task.battery_capacity, t)
            assert m == t
            ends[:n] = ranked[:n, task.battery_capacity - m, t][:, None, None]
            later = np.arange(t + 1)
            ends[n] = ranked[n, later + task.battery_capacity - m, t - later]
        rows = ((n + 1) + (stops << n)) * (most + 1)
        ranks = np.zeros((rows, t + 1), ranked.dtype)
        ranks[: (n + 1) * (most + 1)] = ends.reshape(-1, t + 1)
        cells = self.tables.cells
        self.legs = Legs(
            self.tables, int(counts), np.zeros(cells, np.uint8), np.zeros(stops, np.int64),
            np.full(cells, NO_STOP, np.int32), n, most, ranks,
        )
        self.scores = scores
        self.ways, self.rounds = make_ways(task, stops * (pads + 1)), make_rounds(task)
        self.distances = make_distances(stops)
        self.rewards = tabulate_rewards(task, RewardProfile(id="none", summary="nothing"))
        self.grid, self.state = np.zeros(cells, np.uint8), np.zeros(state_size(self.tables), np.uint16)
        self.entries = PARCELS + np.arange(n)
        states = maps * per_map + 1
        self.room = states * stops * min(12, self.ways.units.shape[1] + 1) + stops * 64
        self.view = make_view(states, stops, self.room)
        self.values = np.zeros(self.room, np.float32)

    def lessons(self, seeds):
        m = lesson_kernel(
            self.tables, self.rewards, self.legs, self.scores, self.grid, self.state, self.entries, self.distances,
            self.ways, self.rounds, seeds, self.per_map, self.view, self.values, 0,
        )
        v = self.view
        o = v.begins[m]
        return View(v.tokens[:m].copy(), v.present[:m].copy(), v.edges[:m].copy(), v.begins[: m + 1].copy(), v.token[:o].copy(), v.features[:o].copy(), v.numbers[:o].copy()), self.values[:o].copy()
