"""The features of the tour network: tokens, the edges between them, and the options to choose from.

Token 0 is the drone; the waiting parcels and the pads follow. An option is one undominated path to one of them
(`planning.paths`), or one WAIT on the pad below. All features are ratios of units to the battery's capacity and of
steps to `max_steps`. They contain no coordinates, so they do not depend on the size of a map.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import N_ACTIONS, WAIT
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, PAD_CELL
from drone_env.core.compiled import jitable, kernel
from drone_env.core.rules import units_left
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.planning.paths import NO_STOP, UNREACHED, PathSearch, find_paths, make_search
from drone_env.planning.states import require_memory

STATES_AT_ONCE = 256
"""Maximum number of states per call: their features fit into the processor's cache."""
CHUNK_BYTES = 1 << 25
"""Maximum size of their features, unless a single state takes more."""
CACHE_BYTES = 1 << 24
"""Size of the cache of distances, unless those of a chunk take more."""
FAR = 1.5
"""Value of an unreachable distance, in capacities or in eighths of `max_steps`."""
STEP_SCALE = 8.0
"""Scale of steps, which brings them to the size of units."""

# The indices of the features. Units are in capacities of the battery, steps in eighths of `max_steps`, truth values
# are 1 or 0. The indices and their meaning are frozen: weights depend on them.

TOKEN_FEATURES = 22
IS_DRONE, IS_PARCEL, IS_PAD = 0, 1, 2
HERE = 3
"""Whether the drone is above this pad."""
CHEAP_UNITS, CHEAP_STEPS, FAST_STEPS = 4, 5, 6
"""From the drone: units and steps of the cheapest path, steps of the fastest."""
REACHED = 7
"""Whether there is a path that the battery has the units for; 0 for the pad that the drone is above."""
ARRIVAL = 8
"""Units left after the cheapest path."""
TO_PAD, TO_PARCEL = 9, 10
"""Units of the cheapest path from here to the nearest other pad and parcel; the drone has the first alone."""
SPARE, SAFE = 11, 12
"""`ARRIVAL` less the units to the nearest pad, which none needs on a pad or when the last parcel is delivered; whether
some are left."""
UNITS, LEFT, WAITING, LAST_PARCEL, CHARGE, SMALL_BATTERY, SHORT_TIME, TWO_PARCELS, PADS = range(13, TOKEN_FEATURES)
"""The same on each token: units left; steps left / `max_steps`; parcels that wait / 5; whether one does; units of a
charge; 10 / capacity; 40 / `max_steps`; whether two parcels wait; pads / 5."""

EDGE_FEATURES = 10
OUT_UNITS, OUT_STEPS, OUT_FAST_STEPS = 0, 1, 2
"""From the first token to the second: units and steps of the cheapest path, steps of the fastest."""
BACK_UNITS, BACK_STEPS = 3, 4
"""The reverse direction. For a pair with the drone, both directions hold the path from the drone."""
OUT_ARRIVAL, OUT_REACHES = 5, 6
"""`ARRIVAL` at the first less the units from there to the second; whether some are left."""
BACK_ARRIVAL, BACK_REACHES = 7, 8
"""The same from the second token to the first."""
WITHIN_CAPACITY = 9
"""Whether a full battery lasts from the first to the second."""

OPTION_FEATURES = 9
DRAINED, TAKEN = 0, 1
"""Units, below zero for a charge, and steps."""
AFTER = 2
"""Units left."""
AFTER_SPARE, AFTER_SAFE = 3, 4
"""As `SPARE` and `SAFE`, after this path."""
CHARGES = 5
"""Whether it is a charge."""
MORE_UNITS, MORE_STEPS = 6, 7
"""Units beyond those of the cheapest path to the same stop, steps beyond those of the fastest."""
LEFT_AFTER = 8
"""Steps left / `max_steps`."""


class Distances(NamedTuple):
    """From each stop (first axis) to each: int32[N, N], `UNREACHED` if there is no path. Parcels do not end a path."""

    cheap_units: Any
    """Units of the cheapest path."""
    cheap_steps: Any
    """Its steps."""
    fast_steps: Any
    """Steps of the fastest path."""


class Features(NamedTuple):
    """The features of M states of one task with N stops; the options of all states are concatenated."""

    tokens: Any
    """float32[M, N + 1, 22]"""
    present: Any
    """bool[M, N + 1], whether there is such a token."""
    edges: Any
    """float32[M, N + 1, N + 1, 10], from the first token to the second."""
    begins: Any
    """int64[M + 1], index of the first option of each state."""
    token: Any
    """int32[options], the token that each leads to."""
    options: Any
    """float32[options, 9]"""
    numbers: Any
    """int32[options, 3]: units (below zero for a charge), steps, first action."""


class TourState(NamedTuple):
    """A state of an episode between its stops."""

    stops: Any
    """int64[N], the cells of the parcels and pads."""
    parcels: int
    """Number of parcels; they are the first stops."""
    delivered: int
    """Bit i for parcel i."""
    cell: int
    """The drone's cell."""
    units: int
    """Battery units left."""
    left: int
    """Steps left."""


def make_features(states: int, stops: int, options: int) -> Features:
    """Allocate the features of this many states and options in all."""
    return Features(
        np.zeros((states, stops + 1, TOKEN_FEATURES), np.float32),
        np.zeros((states, stops + 1), np.bool_),
        np.zeros((states, stops + 1, stops + 1, EDGE_FEATURES), np.float32),
        np.zeros(states + 1, np.int64),
        np.zeros(options, np.int32),
        np.zeros((options, OPTION_FEATURES), np.float32),
        np.zeros((options, 3), np.int32),
    )


def first_states(features: Features, m: int) -> Features:
    """The features of the first m states, without copying."""
    options = features.begins[m]
    by_state = (features.tokens[:m], features.present[:m], features.edges[:m], features.begins[: m + 1])
    return Features(*by_state, features.token[:options], features.options[:options], features.numbers[:options])


@jitable
def find_distances(search: PathSearch, stops: Any, distances: Distances) -> None:
    """Find the distances between all stops, on a map without waiting parcels."""
    cheap_units, cheap_steps, fast_steps = distances
    paths = search.paths
    for i in range(len(stops)):
        find_paths(search, stops[i], search.tables.capacity, 0)
        for j in range(len(stops)):
            n = paths.count[j]
            if i == j:
                cheap_units[i, j] = cheap_steps[i, j] = fast_steps[i, j] = 0
            elif n == 0:
                cheap_units[i, j] = cheap_steps[i, j] = fast_steps[i, j] = UNREACHED
            else:
                cheap_steps[i, j] = paths.steps[j, n - 1]
                cheap_units[i, j] = paths.units[j, n - 1] if search.counts else cheap_steps[i, j]
                fast_steps[i, j] = paths.steps[j, 0]


@jitable
def write_features(search: PathSearch, state: TourState, distances: Distances, features: Features, m: int) -> None:
    """Write the features of one state as number m.

    Args:
        search: The map, after `find_paths` from the drone.
        state: The state.
        distances: Between the stops.
        features: The output.
        m: The number of the state; those below it are written.
    """
    n, parcels = len(state.stops), state.parcels
    waiting = 0
    for i in range(parcels):
        waiting += 1 - (state.delivered >> i & 1)
    features.tokens[m, : n + 1] = 0.0
    features.edges[m, : n + 1, : n + 1] = 0.0
    features.present[m, 0] = True
    features.tokens[m, 0, IS_DRONE] = 1.0
    features.begins[m + 1] = features.begins[m]
    home = UNREACHED
    for i in range(n):
        features.present[m, i + 1] = i >= parcels or not (state.delivered >> i & 1)
        if features.present[m, i + 1]:
            token = features.tokens[m, i + 1]
            safe = write_surroundings(search, state, waiting, distances, token, i)
            if state.stops[i] == state.cell:
                home = 0
                write_charge(search, state, token, features, m, i)
            else:
                cheapest = write_paths(search, state, safe, token, features, m, i)
                if i >= parcels:
                    home = min(home, cheapest)
            token[SPARE] = token[ARRIVAL] - safe
            token[SAFE] = token[SPARE] > 0.0
    capacity = np.float32(search.tables.capacity)
    features.tokens[m, 0, TO_PAD] = np.float32(home) / capacity if home < UNREACHED else np.float32(FAR)
    for t in range(n + 1):
        if features.present[m, t]:
            write_mission(search, state, waiting, features.tokens[m, t])
    for s in range(n + 1):
        for t in range(n + 1):
            if s != t and features.present[m, s] and features.present[m, t]:
                write_edge(search, state.units, distances, features.tokens[m], features.edges[m], s, t)


@jitable
def write_surroundings(
    search: PathSearch, state: TourState, waiting: int, distances: Distances, token: Any, i: int
) -> Any:
    """Write the kind of stop i and the distances to the nearest others, and return the units that are safe there."""
    capacity = np.float32(search.tables.capacity)
    next_pad = next_parcel = UNREACHED
    for j in range(len(state.stops)):
        if j != i and j >= state.parcels:
            next_pad = min(next_pad, distances.cheap_units[i, j])
        elif j != i and not (state.delivered >> j & 1):
            next_parcel = min(next_parcel, distances.cheap_units[i, j])
    to_pad = np.float32(next_pad) / capacity if next_pad < UNREACHED else np.float32(FAR)
    token[IS_PARCEL] = i < state.parcels
    token[IS_PAD] = i >= state.parcels
    token[TO_PAD] = to_pad
    token[TO_PARCEL] = np.float32(next_parcel) / capacity if next_parcel < UNREACHED else np.float32(FAR)
    return np.float32(0.0) if i >= state.parcels or waiting == 1 else to_pad


@jitable
def charge_of(search: PathSearch) -> int:
    """Units of one charge; a larger one than the capacity only fills the battery."""
    return min(-search.tables.drain[PAD_CELL * N_ACTIONS + WAIT], search.tables.capacity)


@jitable
def write_charge(search: PathSearch, state: TourState, token: Any, features: Features, m: int, i: int) -> None:
    """Write the token of the stop below the drone, and the option to charge there."""
    capacity, max_steps = np.float32(search.tables.capacity), np.float32(search.tables.max_steps)
    units, left = state.units, state.left
    token[HERE] = 1.0
    token[ARRIVAL] = units / capacity
    charged = units_left(search.tables, units, -charge_of(search))
    if charged <= units or left <= 0:
        return
    number = features.begins[m + 1]
    features.begins[m + 1] = number + 1
    features.token[number] = i + 1
    features.numbers[number, 0], features.numbers[number, 1] = units - charged, 1
    features.numbers[number, 2] = WAIT
    option = features.options[number]
    option[:] = 0.0
    option[DRAINED] = (units - charged) / capacity
    option[TAKEN] = np.float32(STEP_SCALE) / max_steps
    option[AFTER] = option[AFTER_SPARE] = charged / capacity
    option[AFTER_SAFE] = option[CHARGES] = 1.0
    option[LEFT_AFTER] = (left - 1) / max_steps


@jitable
def write_paths(search: PathSearch, state: TourState, safe: Any, token: Any, features: Features, m: int, i: int) -> int:
    """Write the token of a stop and an option for each path to it. Return the units of the cheapest path."""
    capacity, max_steps = np.float32(search.tables.capacity), np.float32(search.tables.max_steps)
    per_step = np.float32(STEP_SCALE) / max_steps
    counts, paths, units, left = search.counts, search.paths, state.units, state.left
    last = paths.count[i] - 1
    if last < 0:
        token[CHEAP_UNITS] = token[CHEAP_STEPS] = token[FAST_STEPS] = FAR
        return UNREACHED
    fastest = paths.steps[i, 0]
    cheapest = paths.units[i, last] if counts else paths.steps[i, last]
    token[CHEAP_UNITS] = cheapest / capacity
    token[CHEAP_STEPS] = paths.steps[i, last] * per_step
    token[FAST_STEPS] = fastest * per_step
    token[REACHED] = 1.0
    token[ARRIVAL] = (units - cheapest) / capacity
    number = features.begins[m + 1]
    for k in range(last + 1):
        steps = paths.steps[i, k]
        parcel = i < state.parcels
        # With the step to a parcel a drone may drain more than it has.
        drained = (min(paths.units[i, k], units) if parcel else paths.units[i, k]) if counts else steps
        if drained > units or (drained == units and not parcel) or steps > left:
            continue
        features.token[number] = i + 1
        features.numbers[number, 0], features.numbers[number, 1] = drained, steps
        features.numbers[number, 2] = paths.first[i, k]
        option = features.options[number]
        option[DRAINED] = drained / capacity
        option[TAKEN] = steps * per_step
        option[AFTER] = (units - drained) / capacity
        option[AFTER_SPARE] = (units - drained) / capacity - safe
        option[AFTER_SAFE] = option[AFTER_SPARE] > 0.0
        option[CHARGES] = 0.0
        option[MORE_UNITS] = (drained - cheapest) / capacity
        option[MORE_STEPS] = (steps - fastest) * per_step
        option[LEFT_AFTER] = (left - steps) / max_steps
        number += 1
    features.begins[m + 1] = number
    return cheapest


@jitable
def write_mission(search: PathSearch, state: TourState, waiting: int, token: Any) -> None:
    """Write the features that are the same on each token."""
    capacity, max_steps = np.float32(search.tables.capacity), np.float32(search.tables.max_steps)
    token[UNITS] = state.units / capacity
    token[LEFT] = state.left / max_steps
    token[WAITING] = waiting / np.float32(5.0)
    token[LAST_PARCEL] = waiting == 1
    token[CHARGE] = charge_of(search) / capacity
    token[SMALL_BATTERY] = np.float32(10.0) / capacity
    token[SHORT_TIME] = np.float32(40.0) / max_steps
    token[TWO_PARCELS] = waiting == 2
    token[PADS] = (len(state.stops) - state.parcels) / np.float32(5.0)


@jitable
def write_edge(search: PathSearch, units: int, distances: Distances, tokens: Any, edges: Any, s: int, t: int) -> None:
    """Write the edge from token s to token t, and the reverse features of the edge back."""
    capacity, max_steps = np.float32(search.tables.capacity), np.float32(search.tables.max_steps)
    per_step = np.float32(STEP_SCALE) / max_steps
    arrival = tokens[s, ARRIVAL] if s > 0 else np.float32(units) / capacity
    if s == 0 or t == 0:
        out_units, out_steps = tokens[s + t, CHEAP_UNITS], tokens[s + t, CHEAP_STEPS]
        fastest_steps = tokens[s + t, FAST_STEPS]
    elif distances.cheap_units[s - 1, t - 1] == UNREACHED:
        out_units = out_steps = fastest_steps = np.float32(FAR)
    else:
        out_units = np.float32(distances.cheap_units[s - 1, t - 1]) / capacity
        out_steps = np.float32(distances.cheap_steps[s - 1, t - 1]) * per_step
        fastest_steps = np.float32(distances.fast_steps[s - 1, t - 1]) * per_step
    edge, back = edges[s, t], edges[t, s]
    edge[OUT_UNITS] = back[BACK_UNITS] = out_units
    edge[OUT_STEPS] = back[BACK_STEPS] = out_steps
    edge[OUT_FAST_STEPS] = fastest_steps
    edge[OUT_ARRIVAL] = back[BACK_ARRIVAL] = arrival - out_units
    edge[OUT_REACHES] = back[BACK_REACHES] = arrival - out_units > 0.0
    edge[WITHIN_CAPACITY] = out_units < 1.0


@kernel
def encode_kernel(
    grounds: Any,
    drones: Any,
    pads: int,
    places: Any,
    missing: Any,
    search: PathSearch,
    stops: Any,
    cache: Distances,
    features: Features,
) -> int:
    """Write the features of M observations and return their number. It stops at one with too many parcels or pads.

    Args:
        grounds: uint8[M, cells], without the drones.
        drones: int64[M, 3]: cell, units left, steps left.
        pads: Number of pads of a map, 0 if they are no stops.
        places: int64[M], the place of each state's distances in the cache.
        missing: bool[M], whether they are still missing there.
        search: Working memory.
        stops: int64[N], working memory.
        cache: int32[places, N, N] each, distances between the stops of a state.
        features: The output.
    """
    tables, ground, stop_at = search.tables, search.ground, search.stop_at
    features.begins[0] = 0
    room = len(stops)
    for m in range(len(grounds)):
        n = delivered = 0
        for c in range(tables.cells):
            ground[c] = grounds[m, c]
            stop_at[c] = NO_STOP
            delivered += ground[c] == DELIVERED_CELL
            if ground[c] == DELIVERY_CELL:
                if n + delivered >= tables.deliveries:
                    return m
                # Parcels do not end the paths between stops.
                ground[c] = DELIVERED_CELL
                stops[n] = c
                n += 1
        parcels = n
        if parcels + delivered > tables.deliveries:
            return m
        for c in range(tables.cells):
            if pads > 0 and ground[c] == PAD_CELL:
                if n == parcels + pads:
                    return m
                stops[n] = c
                n += 1
        for i in range(n):
            stop_at[stops[i]] = i
        place = places[m]
        distances = Distances(cache.cheap_units[place], cache.cheap_steps[place], cache.fast_steps[place])
        if missing[m]:
            find_distances(search, stops[:n], distances)
        for i in range(parcels):
            ground[stops[i]] = DELIVERY_CELL
        cell, units, left = drones[m]
        find_paths(search, cell, units, 0)
        for t in range(n + 1, room + 1):
            features.present[m, t] = False
            features.tokens[m, t] = 0.0
            features.edges[m, t] = 0.0
            features.edges[m, :, t] = 0.0
        write_features(search, TourState(stops[:n], parcels, 0, cell, units, left), distances, features, m)
    return len(grounds)


class FeatureEncoder:
    """Encodes observations of one task as features. Not thread-safe.

    It caches the distances between stops, which only a delivery changes.

    Args:
        task: The task.

    Attributes:
        task: The task.
        most: Maximum number of observations per call.
        tokens: Number of tokens of a state.

    Raises:
        TooLargeError: if the features of one state would take too much memory.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.task = task
        self._pads = 0 if task.uniform or not task.charge_rate else task.pads
        n = task.deliveries + self._pads
        self.tokens = n + 1
        search = make_search(task, n)
        options = n * search.paths.units.shape[1]
        size = 4 * ((n + 1) ** 2 * EDGE_FEATURES + options * (OPTION_FEATURES + 4))
        require_memory("the features", task, size)
        self.most = max(1, min(STATES_AT_ONCE, CHUNK_BYTES // size))
        self._room = max(self.most, CACHE_BYTES // (12 * n * n))
        self._working_memory = search, np.zeros(n, np.int64), Distances(*np.zeros((3, self._room, n, n), np.int32))
        self._place_of: dict[bytes, int] = {}
        self._features = make_features(self.most, n, self.most * options)

    def encode(self, grounds: npt.NDArray[np.uint8], drones: npt.NDArray[np.int64]) -> Features:
        """The features of M states, at most `most`; the next call overwrites them.

        Args:
            grounds: uint8[M, cells], without the drones.
            drones: int64[M, 3]: cell, units left, steps left.

        Raises:
            InvalidValueError: if one has more parcels or pads than the task.
        """
        m = len(grounds)
        if len(self._place_of) + m > self._room:
            self._place_of.clear()
        places, missing = np.zeros(m, np.int64), np.zeros(m, np.bool_)
        for i, ground in enumerate(grounds):
            new = len(self._place_of)
            places[i] = self._place_of.setdefault(ground.tobytes(), new)
            missing[i] = places[i] == new
        if encode_kernel(grounds, drones, self._pads, places, missing, *self._working_memory, self._features) < m:
            self._place_of.clear()  # it contains maps whose distances are missing
            raise InvalidValueError(f"an observation shows more parcels or pads than {self.task.id!r} has")
        return first_states(self._features, m)
