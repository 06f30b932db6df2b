"""Training samples of a tour network: states of flights, with the exact value of each of their options.

The values are those of `planning.legs`. Flights begin at the start of a map or anywhere on it; they follow the best
options and at times others. An option that loses the mission is labelled but not flown, so flights stay where decisions
matter. The states depend on the seeds of the maps alone, not on the network.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.agents.tour_features import (
    Distances,
    Features,
    TourState,
    find_distances,
    first_states,
    make_distances,
    make_features,
    write_features,
)
from drone_env.core.actions import FLYING, Action
from drone_env.core.cells import DELIVERY_CELL, PAD_CELL
from drone_env.core.compiled import jitable, kernel
from drone_env.core.episode import Episode
from drone_env.core.rewards import Rewards, tabulate_rewards
from drone_env.core.rules import choose_target, reset, step
from drone_env.core.seeds import GOLDEN, mix64, next_key, uniform_below
from drone_env.core.tables import BATTERY, CELL, OUTCOME, PARCELS, STEPS, UNDER, Tables, state_size, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.planning.legs import Legs, make_legs, mark_delivered, row_after, row_of, value_kernel
from drone_env.planning.paths import NO_STOP, find_paths, most_paths
from drone_env.planning.solver import ranked_scores
from drone_env.planning.states import UNPAID, delivered_set, put_drone, put_parcels, state_arrays

WAIT = int(Action.WAIT)
COMPLETE = 0.8 - 1e-9
"""Minimum value of a complete mission. (On a uniform task of more than 8 parcels, where battery and time do not end
together, incomplete ones can be as high.)"""
FROM_START, OTHER, NEARLY_BEST, GOES_ON = 40, 35, 20, 85
"""Percentages: flights from the start; options that are not the best; those of them with a regret of at most `NEAR`;
steps after which a flight stays on its path instead of choosing again."""
NEAR = 0.02
KEEP_AT_CHOICE, KEEP_ON_PATH, KEEP_LOST = 75, 20, 20
"""Percentages of states that become samples: at the start of a path, on it, and after the mission is lost."""


class Workspace(NamedTuple):
    """Working memory for a map of a task."""

    tables: Tables
    rewards: Rewards
    grid: Any
    """uint8[cells]"""
    state: Any
    """uint16[state size]"""
    parcels: Any
    """int64[deliveries], the indices of the parcels in `state`."""


@jitable
def place_stops(workspace: Workspace, legs: Legs) -> None:
    """Write the map of the workspace, without its drone, into the legs."""
    for cell in range(workspace.tables.cells):
        legs.search.stop_at[cell] = NO_STOP
        legs.search.ground[cell] = workspace.grid[cell]
    stop = legs.parcels
    for cell in range(workspace.tables.cells):
        if stop < len(legs.stops) and workspace.grid[cell] == PAD_CELL:
            legs.stops[stop] = cell
            stop += 1
    for i in range(legs.parcels):
        legs.stops[i] = workspace.state[PARCELS + i]
    for i in range(len(legs.stops)):
        legs.search.stop_at[legs.stops[i]] = i


@jitable
def option_row(legs: Legs, delivered: int, done: int, features: Features, option: int, units: int) -> int:
    """The row of `legs.ranks` after an option, `features.numbers[option, 1]` steps later."""
    stop, drained = features.token[option] - 1, features.numbers[option, 0]
    after = units - drained if legs.search.counts else 1
    if drained < 0:
        return row_of(legs, delivered, stop, after)
    return row_after(legs, delivered, done, stop, after)


@jitable
def find_option(features: Features, m: int, token: int, units: int, steps: int) -> int:
    """The option of state m to a token with these units and steps; -1 if there is none."""
    for option in range(features.begins[m], features.begins[m + 1]):
        if (
            features.token[option] == token
            and features.numbers[option, 0] == units
            and features.numbers[option, 1] == steps
        ):
            return option
    return -1


@jitable
def sample_start_state(workspace: Workspace, counts: int, start: int, key: int) -> tuple[int, bool]:
    """Place the drone at the start of the map or anywhere on it; return the next key and whether the cell is free.

    Args:
        workspace: The map, without the drone; it receives the state.
        counts: 1 if units count beside steps.
        start: The cell of the map's start.
        key: The random key.
    """
    tables, _, grid, state, parcels = workspace
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


@kernel
def sample_kernel(
    workspace: Workspace,
    legs: Legs,
    scores: Any,
    distances: Distances,
    seeds: Any,
    per_map: int,
    features: Features,
    values: Any,
) -> int:
    """Write up to `per_map` states of each map and return their number.

    Args:
        workspace: Working memory.
        legs: Working memory, for whole episodes.
        scores: float64[ranks], the score of each rank.
        distances: Working memory.
        seeds: int64[maps]
        per_map: Maximum number of states of each map.
        features: The output.
        values: float32[options], the values of the options, also output.
    """
    tables, rewards, grid, state, parcels = workspace
    m, n, search = 0, legs.parcels, legs.search
    features.begins[0] = 0
    for seed in seeds:
        reset(tables, grid, state, seed)
        start = state[CELL] * 1
        grid[start] = state[UNDER]
        place_stops(workspace, legs)
        mark_delivered(legs, (1 << n) - 1)
        find_distances(search, legs.stops, distances)
        value_kernel(legs)
        key, target = mix64(seed ^ GOLDEN), m + per_map
        for _ in range(4 * per_map):
            if m == target:
                break
            key, flies = sample_start_state(workspace, legs.search.counts, start, key)
            if not flies:
                continue
            chosen_token, path_units, path_steps = -1, 0, 0
            while state[OUTCOME] == FLYING and m < target:
                delivered = delivered_set(state, parcels)
                cell, units, left = state[CELL] * 1, state[BATTERY] * 1, tables.max_steps - state[STEPS]
                still = left if legs.search.counts else min(left, units)
                done = mark_delivered(legs, delivered)
                find_paths(search, cell, units, 0)
                tour = TourState(legs.stops, n, delivered, cell, units, left)
                write_features(search, tour, distances, features, m)
                first, behind = features.begins[m], features.begins[m + 1]
                best, lost, alike = -1, 0, True
                for option in range(first, behind):
                    row = option_row(legs, delivered, done, features, option, units)
                    values[option] = scores[legs.ranks[row, still - features.numbers[option, 1]]]
                    alike &= values[option] == values[first]
                    lost += values[option] < COMPLETE
                    if best < 0 or values[option] > values[best]:
                        best = option
                if best < 0:
                    break
                key = next_key(key)
                drawn = uniform_below(key, 200)
                chosen = find_option(features, m, chosen_token, path_units, path_steps)
                keep = KEEP_ON_PATH if chosen >= 0 else KEEP_AT_CHOICE
                if values[best] < COMPLETE:
                    chosen, keep = best, KEEP_LOST
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
                action, before = features.numbers[chosen, 2], units
                chosen_token, path_units, path_steps = (
                    features.token[chosen],
                    features.numbers[chosen, 0],
                    features.numbers[chosen, 1],
                )
                if not alike and drawn < 2 * keep:
                    m += 1
                step(tables, rewards, grid, state, action)
                key = next_key(key)
                path_units -= before - state[BATTERY] if legs.search.counts else 1
                path_steps -= 1
                if action == WAIT or uniform_below(key, 100) >= GOES_ON:
                    chosen_token = -1
            grid[state[CELL]] = state[UNDER]
    return m


class Samples(NamedTuple):
    """States of one task, with the values of their options."""

    features: Features
    values: npt.NDArray[np.float32]
    """float32[options], the highest score that is still possible after each."""


class SampleGenerator:
    """Generates samples on one task.

    Args:
        task: The task.
        maps: Maximum number of maps in a chunk of samples.
        per_map: Maximum number of states of each map.

    Raises:
        UnsupportedTaskError: if `planning.legs` does not cover the task.
        TooLargeError: if the values of a map would take too much memory.
    """

    def __init__(self, task: TaskConfig, maps: int, per_map: int) -> None:
        self.task, self._per_map = task, per_map
        tables = tabulate(task)
        # All maps of a task have the same number of stops.
        ground, state, entries = state_arrays(Episode(task, seed=0))
        legs = make_legs(task, ground, state[entries].tolist(), 0, tables.capacity, tables.max_steps)
        scores, _ = ranked_scores(task)
        grid, state = np.zeros(tables.cells, np.uint8), np.zeros(state_size(tables), np.uint16)
        workspace = Workspace(tables, tabulate_rewards(task, UNPAID), grid, state, entries)
        stops = len(legs.stops)
        self._working_memory = workspace, legs, scores, make_distances(stops)
        states = maps * per_map + 1
        options = states * stops * most_paths(task)
        self._features, self._values = make_features(states, stops, options), np.zeros(options, np.float32)

    def generate(self, seeds: npt.NDArray[np.int64]) -> Samples:
        """The samples of these maps."""
        m = sample_kernel(*self._working_memory, seeds, self._per_map, self._features, self._values)
        features = Features(*(array.copy() for array in first_states(self._features, m)))
        return Samples(features, self._values[: len(features.token)].copy())
