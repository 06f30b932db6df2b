"""The features of the tour network: tokens, the edges between them, and the options to choose from.

Token 0 is the drone; the waiting parcels and the pads follow. An option is one undominated path to one of them
(`planning.paths`), or one WAIT on the pad below. All features are ratios of units to the battery's capacity and of
steps to `max_steps`. They contain no coordinates, so they do not depend on the size of a map.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import N_ACTIONS, Action
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, PAD_CELL
from drone_env.core.compiled import jitable, kernel
from drone_env.core.rules import units_left
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.planning.from_observation import read_observations
from drone_env.planning.paths import NO_STOP, UNREACHED, PathSearch, find_paths, make_search
from drone_env.planning.states import require_memory

WAIT = int(Action.WAIT)
CHUNK = 256
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


def make_distances(stops: int) -> Distances:
    """Allocate the distances between this many stops."""
    return Distances(*np.zeros((3, stops, stops), np.int32))


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
def write_features(
    search: PathSearch,
    stops: Any,
    parcels: int,
    delivered: int,
    cell: int,
    units: int,
    left: int,
    distances: Distances,
    features: Features,
    m: int,
) -> None:
    """Write the features of one state as number m.

    Args:
        search: The map, after `find_paths` from the drone.
        stops: int64[N], the cells of the parcels and pads.
        parcels: Number of parcels; they are the first stops.
        delivered: Bit i for parcel i.
        cell: The drone's cell.
        units: Battery units left.
        left: Steps left.
        distances: Between the stops.
        features: The output.
        m: The number of the state; those below it are written.
    """
    tables, counts, paths = search.tables, search.counts, search.paths
    capacity, max_steps = np.float32(tables.capacity), np.float32(tables.max_steps)
    per_step = np.float32(STEP_SCALE) / max_steps
    cheap_units, cheap_steps, fast_steps = distances
    n = len(stops)
    tokens, present, edges = features.tokens, features.present, features.edges
    # A larger charge than the capacity only fills the battery.
    charge = min(-tables.drain[PAD_CELL * N_ACTIONS + WAIT], tables.capacity)
    waiting = 0
    for i in range(parcels):
        waiting += 1 - (delivered >> i & 1)
    option = features.begins[m]
    tokens[m, : n + 1] = 0.0
    edges[m, : n + 1, : n + 1] = 0.0
    present[m, 0] = True
    tokens[m, 0, IS_DRONE] = 1.0
    home = UNREACHED
    for i in range(n):
        t = i + 1
        present[m, t] = i >= parcels or not (delivered >> i & 1)
        if not present[m, t]:
            continue
        next_pad = next_parcel = UNREACHED
        for j in range(n):
            if j != i and (j >= parcels or not (delivered >> j & 1)):
                if j >= parcels:
                    next_pad = min(next_pad, cheap_units[i, j])
                else:
                    next_parcel = min(next_parcel, cheap_units[i, j])
        to_pad = np.float32(next_pad) / capacity if next_pad < UNREACHED else np.float32(FAR)
        safe = np.float32(0.0) if i >= parcels or waiting == 1 else to_pad
        tokens[m, t, IS_PARCEL] = i < parcels
        tokens[m, t, IS_PAD] = i >= parcels
        tokens[m, t, TO_PAD] = to_pad
        tokens[m, t, TO_PARCEL] = np.float32(next_parcel) / capacity if next_parcel < UNREACHED else np.float32(FAR)
        here = stops[i] == cell
        n_paths = paths.count[i]
        if here:
            tokens[m, t, HERE] = 1.0
            home = 0
            charged = units_left(tables, units, -charge)
            tokens[m, t, ARRIVAL] = units / capacity
            if charged > units and left > 0:
                features.token[option] = t
                features.numbers[option, 0], features.numbers[option, 1] = units - charged, 1
                features.numbers[option, 2] = WAIT
                features.options[option] = 0.0
                features.options[option, DRAINED] = (units - charged) / capacity
                features.options[option, TAKEN] = per_step
                features.options[option, AFTER] = features.options[option, AFTER_SPARE] = charged / capacity
                features.options[option, AFTER_SAFE] = features.options[option, CHARGES] = 1.0
                features.options[option, LEFT_AFTER] = (left - 1) / max_steps
                option += 1
        elif n_paths == 0:
            tokens[m, t, CHEAP_UNITS] = tokens[m, t, CHEAP_STEPS] = tokens[m, t, FAST_STEPS] = FAR
        else:
            last = n_paths - 1
            cheapest = paths.units[i, last] if counts else paths.steps[i, last]
            fastest = paths.steps[i, 0]
            if i >= parcels:
                home = min(home, cheapest)
            tokens[m, t, CHEAP_UNITS] = cheapest / capacity
            tokens[m, t, CHEAP_STEPS] = paths.steps[i, last] * per_step
            tokens[m, t, FAST_STEPS] = fastest * per_step
            tokens[m, t, REACHED] = 1.0
            tokens[m, t, ARRIVAL] = (units - cheapest) / capacity
            for k in range(n_paths):
                steps = paths.steps[i, k]
                # With the step to a parcel a drone may drain more than it has.
                drained = (min(paths.units[i, k], units) if i < parcels else paths.units[i, k]) if counts else steps
                if drained > units or (drained == units and i >= parcels) or steps > left:
                    continue
                features.token[option] = t
                features.numbers[option, 0], features.numbers[option, 1] = drained, steps
                features.numbers[option, 2] = paths.first[i, k]
                features.options[option, DRAINED] = drained / capacity
                features.options[option, TAKEN] = steps * per_step
                features.options[option, AFTER] = (units - drained) / capacity
                features.options[option, AFTER_SPARE] = (units - drained) / capacity - safe
                features.options[option, AFTER_SAFE] = features.options[option, AFTER_SPARE] > 0.0
                features.options[option, CHARGES] = 0.0
                features.options[option, MORE_UNITS] = (drained - cheapest) / capacity
                features.options[option, MORE_STEPS] = (steps - fastest) * per_step
                features.options[option, LEFT_AFTER] = (left - steps) / max_steps
                option += 1
        tokens[m, t, SPARE] = tokens[m, t, ARRIVAL] - safe
        tokens[m, t, SAFE] = tokens[m, t, SPARE] > 0.0
    tokens[m, 0, TO_PAD] = np.float32(home) / capacity if home < UNREACHED else np.float32(FAR)
    features.begins[m + 1] = option
    for t in range(n + 1):
        if present[m, t]:
            tokens[m, t, UNITS] = units / capacity
            tokens[m, t, LEFT] = left / max_steps
            tokens[m, t, WAITING] = waiting / np.float32(5.0)
            tokens[m, t, LAST_PARCEL] = waiting == 1
            tokens[m, t, CHARGE] = charge / capacity
            tokens[m, t, SMALL_BATTERY] = np.float32(10.0) / capacity
            tokens[m, t, SHORT_TIME] = np.float32(40.0) / max_steps
            tokens[m, t, TWO_PARCELS] = waiting == 2
            tokens[m, t, PADS] = (n - parcels) / np.float32(5.0)
    for s in range(n + 1):
        arrival = tokens[m, s, ARRIVAL] if s > 0 else np.float32(units) / capacity
        for t in range(n + 1):
            if s == t or not present[m, s] or not present[m, t]:
                continue
            if s == 0 or t == 0:
                out_units, out_steps = tokens[m, s + t, CHEAP_UNITS], tokens[m, s + t, CHEAP_STEPS]
                fastest_steps = tokens[m, s + t, FAST_STEPS]
            elif cheap_units[s - 1, t - 1] == UNREACHED:
                out_units = out_steps = fastest_steps = np.float32(FAR)
            else:
                out_units = np.float32(cheap_units[s - 1, t - 1]) / capacity
                out_steps = np.float32(cheap_steps[s - 1, t - 1]) * per_step
                fastest_steps = np.float32(fast_steps[s - 1, t - 1]) * per_step
            edges[m, s, t, OUT_UNITS] = edges[m, t, s, BACK_UNITS] = out_units
            edges[m, s, t, OUT_STEPS] = edges[m, t, s, BACK_STEPS] = out_steps
            edges[m, s, t, OUT_FAST_STEPS] = fastest_steps
            edges[m, s, t, OUT_ARRIVAL] = edges[m, t, s, BACK_ARRIVAL] = arrival - out_units
            edges[m, s, t, OUT_REACHES] = edges[m, t, s, BACK_REACHES] = arrival - out_units > 0.0
            edges[m, s, t, WITHIN_CAPACITY] = out_units < 1.0


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
        write_features(search, stops[:n], parcels, 0, cell, units, left, distances, features, m)
    return len(grounds)


class FeatureEncoder:
    """Encodes observations of one task as features. Not thread-safe.

    It caches the distances between stops, which only a delivery changes.

    Args:
        task: The task.

    Attributes:
        most: Maximum number of observations per call.

    Raises:
        TooLargeError: if the features of one state would take too much memory.
    """

    def __init__(self, task: TaskConfig) -> None:
        self._task = task
        self._pads = 0 if task.uniform or not task.charge_rate else task.pads
        n = task.deliveries + self._pads
        search = make_search(task, n)
        options = n * search.paths.units.shape[1]
        size = 4 * ((n + 1) ** 2 * EDGE_FEATURES + options * (OPTION_FEATURES + 4))
        require_memory("the features", task, size)
        self.most = max(1, min(CHUNK, CHUNK_BYTES // size))
        self._room = max(self.most, CACHE_BYTES // (12 * n * n))
        self._working_memory = search, np.zeros(n, np.int64), Distances(*np.zeros((3, self._room, n, n), np.int32))
        self._place_of: dict[bytes, int] = {}
        self._features = make_features(self.most, n, self.most * options)

    def __call__(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> Features:
        """The features of M observations, at most `most`; the next call overwrites them.

        Args:
            grids: uint8[M, height, width]
            telemetry: float32[M, telemetry_size]

        Raises:
            InvalidValueError: if they are no observations of the task: one shows more parcels, pads or battery than the
                task has, or a drone beside its grid.
        """
        grounds, drones = read_observations(self._task, grids, telemetry)
        most = self._task.battery_capacity, self._task.max_steps
        if not ((drones[:, 1:] >= 0) & (drones[:, 1:] <= most)).all():
            raise InvalidValueError(f"an observation has battery or steps left that {self._task.id!r} does not have")
        return self.encode(grounds, drones)

    def encode(self, grounds: npt.NDArray[np.uint8], drones: npt.NDArray[np.int64]) -> Features:
        """The features of M states.

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
            raise InvalidValueError(f"an observation shows more parcels or pads than {self._task.id!r} has")
        return first_states(self._features, m)
