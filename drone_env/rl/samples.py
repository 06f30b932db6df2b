"""Training samples of a tour network: states of flights, with the exact value of each of their options.

The values are those of `planning.legs`. Flights begin at the start of a map or anywhere on it; they follow the best
options and at times others. An option that loses the mission is labelled but not flown, so flights stay where decisions
matter. The states depend on the seeds of the maps alone, not on the network.
"""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.agents.tour_features import (
    Distances,
    Features,
    TourState,
    find_distances,
    first_states,
    make_features,
    write_features,
)
from drone_env.core.actions import FLYING, WAIT
from drone_env.core.cells import DELIVERY_CELL
from drone_env.core.compiled import inlined, kernel
from drone_env.core.episode import Episode
from drone_env.core.rewards import Rewards, tabulate_rewards
from drone_env.core.rules import choose_target, step
from drone_env.core.seeds import GOLDEN, mix64, next_key, uniform_below
from drone_env.core.tables import BATTERY, CELL, OUTCOME, STEPS, UNDER, Tables, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.planning.legs import Legs, make_legs, mark_delivered, row_after, row_of, value_kernel
from drone_env.planning.paths import find_paths, most_paths
from drone_env.planning.solver import ranked_scores
from drone_env.planning.states import UNPAID, delivered_set, put_drone, put_parcels, state_arrays

FROM_START, OTHER, NEARLY_BEST, GOES_ON = 40, 35, 20, 85
"""Percentages: flights from the start; options that are not the best; those of them with a regret of at most `NEAR`;
steps after which a flight stays on its path instead of choosing again."""
NEAR = 0.02
KEEP_AT_CHOICE, KEEP_ON_PATH, KEEP_LOST = 75, 20, 20
"""Percentages of states that become samples: at the start of a path, on it, and after the mission is lost."""


class Workspace(NamedTuple):
    """A map of a task with its values, and working memory."""

    tables: Tables
    rewards: Rewards
    grid: Any
    """uint8[cells]"""
    state: Any
    """uint16[state size]"""
    parcels: Any
    """int64[deliveries], the indices of the parcels in `state`."""
    legs: Legs
    """Of whole episodes: all parcels wait at the start."""
    scores: Any
    """float64[ranks], the score of each rank."""
    delivered: Any
    """int8[ranks], the most parcels with that score."""
    distances: Distances


@inlined
def draw_start(workspace: Workspace, start: int, key: int) -> tuple[int, bool]:
    """Place the drone at the start of the map or anywhere on it; return the next key and whether the cell is free."""
    tables, _, grid, state, parcels, legs, _, _, _ = workspace
    counts = legs.search.counts
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


@inlined
def row_after_option(legs: Legs, delivered: int, done: int, features: Features, option: int, units: int) -> int:
    """The row of `legs.ranks` after an option, `features.numbers[option, 1]` steps later."""
    stop, drained = features.token[option] - 1, features.numbers[option, 0]
    after = units - drained if legs.search.counts else 1
    if drained < 0:
        return row_of(legs, delivered, stop, after)
    return row_after(legs, delivered, done, stop, after)


@inlined
def write_state(workspace: Workspace, features: Features, values: Any, parcels: Any, m: int) -> tuple[int, int, bool]:
    """Write the current state, with the values and parcels of its options, as state m.

    Returns:
        The best option, or -1 if there is none; the number of options that lose a parcel; and whether values differ.
    """
    tables, _, _, state, places, legs, scores, delivered_of, distances = workspace
    search = legs.search
    delivered = delivered_set(state, places)
    cell, units, left = int(state[CELL]), int(state[BATTERY]), tables.max_steps - state[STEPS]
    still = left if search.counts else min(left, units)
    done = mark_delivered(legs, delivered)
    find_paths(search, cell, units, 0)
    tour = TourState(legs.stops, legs.parcels, delivered, cell, units, left)
    write_features(search, tour, distances, features, m)
    first, end, best, lost, differ = features.begins[m], features.begins[m + 1], -1, 0, False
    for option in range(first, end):
        row = row_after_option(legs, delivered, done, features, option, units)
        rank = legs.ranks[row, still - features.numbers[option, 1]]
        values[option], parcels[option] = scores[rank], delivered_of[rank]
        differ |= values[option] != values[first]
        if best < 0 or values[option] > values[best]:
            best = option
    for option in range(first, end):
        lost += parcels[option] < parcels[best]
    return best, lost, differ


@inlined
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


@inlined
def draw_option(features: Features, values: Any, parcels: Any, m: int, best: int, key: int) -> tuple[int, int]:
    """The best option of state m, or another one that loses no parcel; and the next key."""
    first, end = features.begins[m], features.begins[m + 1]
    key = next_key(key)
    other = uniform_below(key, 100)
    allowed = 0.0 if other >= OTHER else NEAR if other < NEARLY_BEST else 1.0
    for _ in range(8):
        key = next_key(key)
        option = first + uniform_below(key, end - first)
        if parcels[option] >= parcels[best] and values[option] >= values[best] - allowed:
            return option, key
    return best, key


@inlined
def sample_flight(
    workspace: Workspace, features: Features, values: Any, parcels: Any, m: int, end: int, goal: int, key: int
) -> tuple[int, int]:
    """Fly from the current state on and write states from number m on, before `end`; return the next m and key.

    States from which fewer parcels than `goal` can be delivered are lost.
    """
    tables, rewards, grid, state, _, legs, _, _, _ = workspace
    token, units, steps = -1, 0, 0  # the rest of the path that the drone is on
    while state[OUTCOME] == FLYING and m < end:
        best, lost, differ = write_state(workspace, features, values, parcels, m)
        if best < 0:
            break
        key = next_key(key)
        drawn = uniform_below(key, 200)
        chosen = find_option(features, m, token, units, steps)
        keep = KEEP_ON_PATH if chosen >= 0 else KEEP_AT_CHOICE
        if parcels[best] < goal:
            chosen, keep = best, KEEP_LOST
        elif lost == 0:
            keep //= 2
        if chosen < 0:
            chosen, key = draw_option(features, values, parcels, m, best, key)
        token, action, battery = features.token[chosen], features.numbers[chosen, 2], int(state[BATTERY])
        units, steps = features.numbers[chosen, 0], features.numbers[chosen, 1]
        if differ and drawn < 2 * keep:
            m += 1
        step(tables, rewards, grid, state, action)
        units -= battery - state[BATTERY] if legs.search.counts else 1
        steps -= 1
        key = next_key(key)
        if action == WAIT or uniform_below(key, 100) >= GOES_ON:
            token = -1
    return m, key


@inlined
def find_goal(workspace: Workspace, start: int, features: Features, values: Any, parcels: Any, m: int) -> int:
    """All parcels if a flight from the start of the map can deliver them, else 0."""
    tables, _, grid, state, places, _, _, _, _ = workspace
    put_parcels(tables, grid, state, places, 0)
    put_drone(tables, grid, state, start, 0, tables.capacity)
    choose_target(tables, state)
    best, _, _ = write_state(workspace, features, values, parcels, m)
    grid[start] = state[UNDER]
    return len(places) if best >= 0 and parcels[best] == len(places) else 0


@kernel
def sample_kernel(
    workspace: Workspace, start: int, seed: int, per_map: int, features: Features, values: Any, parcels: Any, m: int
) -> int:
    """Write up to `per_map` states of a map, from number m on, and return the number of the next state.

    Args:
        workspace: The map, without its drone.
        start: Cell of the drone at the start of the map.
        seed: Number of the map.
        per_map: Maximum number of states.
        features: The output.
        values: float32[options], the values of the options, also output.
        parcels: int8[options], the parcels that a best flight after each option has delivered, also output.
        m: Number of the first state.
    """
    legs = workspace.legs
    mark_delivered(legs, (1 << legs.parcels) - 1)
    find_distances(legs.search, legs.stops, workspace.distances)
    goal = find_goal(workspace, start, features, values, parcels, m)
    key, end = mix64(seed ^ GOLDEN), m + per_map
    for _ in range(4 * per_map):
        if m == end:
            break
        key, flies = draw_start(workspace, start, key)
        if flies:
            m, key = sample_flight(workspace, features, values, parcels, m, end, goal, key)
            workspace.grid[workspace.state[CELL]] = workspace.state[UNDER]
    return m


@lru_cache
def delivered_parcels(task: TaskConfig) -> npt.NDArray[np.int8]:
    """The most parcels of the flights with each score of a task, int8[ranks]."""
    scores, ranks = ranked_scores(task)
    most = np.zeros(len(scores), np.int8)
    np.maximum.at(most, ranks, np.arange(task.deliveries + 1, dtype=np.int8)[:, None, None])
    return most


class Samples(NamedTuple):
    """States of one task, with what each of their options leads to."""

    features: Features
    values: npt.NDArray[np.float32]
    """float32[options], the highest score that is still possible after each."""
    parcels: npt.NDArray[np.int8]
    """int8[options], the parcels that a flight with this score delivers."""


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
        # All maps of a task have the same number of stops.
        stops, states = len(self._workspace(Episode(task, seed=0)).legs.stops), maps * per_map + 1
        options = states * stops * most_paths(task)
        self._features = make_features(states, stops, options)
        self._values, self._parcels = np.zeros(options, np.float32), np.zeros(options, np.int8)

    def _workspace(self, episode: Episode) -> Workspace:
        task, tables, (grid, state, parcels) = self.task, tabulate(self.task), state_arrays(episode)
        legs = make_legs(task, grid, state[parcels].tolist(), 0, tables.capacity, tables.max_steps)
        rewards, (scores, _), delivered = tabulate_rewards(task, UNPAID), ranked_scores(task), delivered_parcels(task)
        distances = Distances(*np.zeros((3, len(legs.stops), len(legs.stops)), np.int32))
        return Workspace(tables, rewards, grid, state, parcels, legs, scores, delivered, distances)

    def generate(self, seeds: npt.NDArray[np.int64]) -> Samples:
        """The samples of these maps."""
        m = self._features.begins[0] = 0
        for seed in seeds.tolist():
            episode = Episode(self.task, seed=seed)
            workspace = self._workspace(episode)
            value_kernel(workspace.legs)
            m = sample_kernel(
                workspace, episode.cell, seed, self._per_map, self._features, self._values, self._parcels, m
            )
        features = Features(*(array.copy() for array in first_states(self._features, m)))
        options = len(features.token)
        return Samples(features, self._values[:options].copy(), self._parcels[:options].copy())
