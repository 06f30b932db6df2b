"""What the tour network sees of a state: tokens, the edges between them, and the options to choose from.

Token 0 is the drone; then come the parcels that wait and the pads. An option is one undominated way to one of them
(`planning.ways`), or one WAIT on the pad below. All features are ratios of units to the battery's capacity and of steps to
`max_steps`: no coordinates, so that maps of any size look alike.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core import compiled
from drone_env.core.actions import N_ACTIONS, Action
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, PAD_CELL
from drone_env.core.compile_cache import compiled_once
from drone_env.core.drone import units_left
from drone_env.core.tables import Tables, tabulate
from drone_env.core.tasks import TERRAIN, TaskConfig
from drone_env.planning.ways import NO_STOP, UNREACHED, Rounds, Ways, counts_units, find_ways, make_rounds, make_ways

WAIT = int(Action.WAIT)
TOKEN_FEATURES, EDGE_FEATURES, OPTION_FEATURES = 22, 10, 9
FAR = 1.5
"""Stands for what cannot be reached, in capacities or `max_steps`."""
STEP_SCALE = 8.0
"""Steps count for less than units: what a leg takes is brought to the same size."""


class Distances(NamedTuple):
    """From each stop (first axis) to each: int32[N, N], `UNREACHED` where nothing leads. Parcels do not end a way."""

    cheap_units: Any
    """Units of the cheapest way."""
    cheap_steps: Any
    """Its steps."""
    fast_steps: Any
    """Steps of the fastest way."""


class View(NamedTuple):
    """Views of M states of one task with N stops, and all their options, one after another."""

    tokens: Any
    """float32[M, N + 1, 22]"""
    present: Any
    """bool[M, N + 1], whether there is such a token."""
    edges: Any
    """float32[M, N + 1, N + 1, 10], from the first token to the second."""
    begins: Any
    """int64[M + 1], where the options of each state begin."""
    token: Any
    """int32[options], the token that each leads to."""
    features: Any
    """float32[options, 9]"""
    numbers: Any
    """int32[options, 3]: units (below zero for a charge), steps, first action."""


def make_distances(stops: int) -> Distances:
    """Room for the distances between this many stops."""
    return Distances(*np.zeros((3, stops, stops), np.int32))


def make_view(states: int, stops: int, options: int) -> View:
    """Room for this many views and options in all."""
    return View(
        np.zeros((states, stops + 1, TOKEN_FEATURES), np.float32),
        np.zeros((states, stops + 1), np.bool_),
        np.zeros((states, stops + 1, stops + 1, EDGE_FEATURES), np.float32),
        np.zeros(states + 1, np.int64),
        np.zeros(options, np.int32),
        np.zeros((options, OPTION_FEATURES), np.float32),
        np.zeros((options, 3), np.int32),
    )


def find_distances(
    tables: Tables,
    ground: Any,
    stops: Any,
    counts: int,
    stop_at: Any,
    distances: Distances,
    ways: Ways,
    rounds: Rounds,
) -> None:
    """Find the distances between all stops, on a ground where no parcel waits."""
    cheap_units, cheap_steps, fast_steps = distances
    for i in range(len(stops)):
        find_ways(tables, ground, stops[i], tables.capacity, counts, stop_at, ways, 0, rounds)
        for j in range(len(stops)):
            n = ways.count[j]
            if i == j:
                cheap_units[i, j] = cheap_steps[i, j] = fast_steps[i, j] = 0
            elif n == 0:
                cheap_units[i, j] = cheap_steps[i, j] = fast_steps[i, j] = UNREACHED
            else:
                cheap_steps[i, j] = ways.steps[j, n - 1]
                cheap_units[i, j] = ways.units[j, n - 1] if counts else cheap_steps[i, j]
                fast_steps[i, j] = ways.steps[j, 0]


def write_view(
    tables: Tables,
    stops: Any,
    parcels: int,
    delivered: int,
    cell: int,
    units: int,
    left: int,
    counts: int,
    distances: Distances,
    ways: Ways,
    view: View,
    m: int,
) -> None:
    """Write the view of one state, whose ways have been found, behind the m that stand there.

    Args:
        tables: The task's tables.
        stops: int64[N], the cells of the parcels and pads.
        parcels: How many of them are parcels: the first.
        delivered: Bit i for parcel i.
        cell: Where the drone is.
        units: Battery units left.
        left: Steps left.
        counts: 1 if units count beside steps.
        distances: Between the stops.
        ways: From the drone to the stops.
        view: Receives it.
        m: How many views stand there.
    """
    capacity, max_steps = np.float32(tables.capacity), np.float32(tables.max_steps)
    per_step = np.float32(STEP_SCALE) / max_steps
    cheap_units, cheap_steps, fast_steps = distances
    n = len(stops)
    tokens, present, edges = view.tokens, view.present, view.edges
    charge = -tables.drain[PAD_CELL * N_ACTIONS + WAIT]
    waiting = 0
    for i in range(parcels):
        waiting += 1 - (delivered >> i & 1)
    option = view.begins[m]
    for f in range(TOKEN_FEATURES):
        tokens[m, 0, f] = 0.0
    present[m, 0] = True
    tokens[m, 0, 0] = 1.0
    home = UNREACHED
    for i in range(n):
        t = i + 1
        present[m, t] = i >= parcels or not (delivered >> i & 1)
        for f in range(TOKEN_FEATURES):
            tokens[m, t, f] = 0.0
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
        tokens[m, t, 1] = i < parcels
        tokens[m, t, 2] = i >= parcels
        tokens[m, t, 9] = to_pad
        tokens[m, t, 10] = np.float32(next_parcel) / capacity if next_parcel < UNREACHED else np.float32(FAR)
        here = stops[i] == cell
        k_ways = ways.count[i]
        if here:
            tokens[m, t, 3] = 1.0
            home = 0
            charged = units_left(tables, units, -charge)
            tokens[m, t, 8] = units / capacity
            if charged > units and left > 0:
                view.token[option] = t
                view.numbers[option, 0], view.numbers[option, 1] = units - charged, 1
                view.numbers[option, 2] = WAIT
                for f in range(OPTION_FEATURES):
                    view.features[option, f] = 0.0
                view.features[option, 0] = (units - charged) / capacity
                view.features[option, 1] = per_step
                view.features[option, 2] = view.features[option, 3] = charged / capacity
                view.features[option, 4] = view.features[option, 5] = 1.0
                view.features[option, 8] = (left - 1) / max_steps
                option += 1
        elif k_ways == 0:
            tokens[m, t, 4] = tokens[m, t, 5] = tokens[m, t, 6] = FAR
        else:
            last = k_ways - 1
            cheapest = ways.units[i, last] if counts else ways.steps[i, last]
            fastest = ways.steps[i, 0]
            if i >= parcels:
                home = min(home, cheapest)
            tokens[m, t, 4] = cheapest / capacity
            tokens[m, t, 5] = ways.steps[i, last] * per_step
            tokens[m, t, 6] = fastest * per_step
            tokens[m, t, 7] = 1.0
            tokens[m, t, 8] = (units - cheapest) / capacity
            for k in range(k_ways):
                drained = ways.units[i, k] if counts else ways.steps[i, k]
                steps = ways.steps[i, k]
                if drained > units or (drained == units and i >= parcels) or steps > left:
                    continue
                view.token[option] = t
                view.numbers[option, 0], view.numbers[option, 1] = drained, steps
                view.numbers[option, 2] = ways.first[i, k]
                view.features[option, 0] = drained / capacity
                view.features[option, 1] = steps * per_step
                view.features[option, 2] = (units - drained) / capacity
                view.features[option, 3] = (units - drained) / capacity - safe
                view.features[option, 4] = view.features[option, 3] > 0.0
                view.features[option, 5] = 0.0
                view.features[option, 6] = (drained - cheapest) / capacity
                view.features[option, 7] = (steps - fastest) * per_step
                view.features[option, 8] = (left - steps) / max_steps
                option += 1
        tokens[m, t, 11] = tokens[m, t, 8] - safe
        tokens[m, t, 12] = tokens[m, t, 11] > 0.0
    tokens[m, 0, 9] = np.float32(home) / capacity if home < UNREACHED else np.float32(FAR)
    view.begins[m + 1] = option
    for t in range(n + 1):
        if present[m, t]:
            tokens[m, t, 13] = units / capacity
            tokens[m, t, 14] = left / max_steps
            tokens[m, t, 15] = waiting / np.float32(5.0)
            tokens[m, t, 16] = waiting == 1
            tokens[m, t, 17] = charge / capacity
            tokens[m, t, 18] = np.float32(10.0) / capacity
            tokens[m, t, 19] = np.float32(40.0) / max_steps
            tokens[m, t, 20] = waiting == 2
            tokens[m, t, 21] = (n - parcels) / np.float32(5.0)
    for s in range(n + 1):
        arrival = tokens[m, s, 8] if s > 0 else np.float32(units) / capacity
        for t in range(n + 1):
            for f in range(EDGE_FEATURES):
                edges[m, s, t, f] = 0.0
            if s == t or not present[m, s] or not present[m, t]:
                continue
            if s == 0 or t == 0:
                stop = s + t
                out_units = back_units = tokens[m, stop, 4]
                out_steps = back_steps = tokens[m, stop, 5]
                fastest_steps = tokens[m, stop, 6]
            else:
                out_units = back_units = out_steps = back_steps = fastest_steps = np.float32(FAR)
                if cheap_units[s - 1, t - 1] < UNREACHED:
                    out_units = np.float32(cheap_units[s - 1, t - 1]) / capacity
                    out_steps = np.float32(cheap_steps[s - 1, t - 1]) * per_step
                    fastest_steps = np.float32(fast_steps[s - 1, t - 1]) * per_step
                if cheap_units[t - 1, s - 1] < UNREACHED:
                    back_units = np.float32(cheap_units[t - 1, s - 1]) / capacity
                    back_steps = np.float32(cheap_steps[t - 1, s - 1]) * per_step
            back_arrival = tokens[m, t, 8] if t > 0 else np.float32(units) / capacity
            edges[m, s, t, 0] = out_units
            edges[m, s, t, 1] = out_steps
            edges[m, s, t, 2] = fastest_steps
            edges[m, s, t, 3] = back_units
            edges[m, s, t, 4] = back_steps
            edges[m, s, t, 5] = arrival - out_units
            edges[m, s, t, 6] = arrival - out_units > 0.0
            edges[m, s, t, 7] = back_arrival - back_units
            edges[m, s, t, 8] = back_arrival - back_units > 0.0
            edges[m, s, t, 9] = out_units < 1.0




for function in (find_distances, write_view):
    register_jitable(**compiled.OPTIONS)(function)


@compiled_once(nogil=True, **compiled.OPTIONS)
def view_kernel(
    tables: Tables,
    ground: Any,
    grids: Any,
    drones: Any,
    counts: int,
    stops: Any,
    stop_at: Any,
    distances: Distances,
    ways: Ways,
    rounds: Rounds,
    view: View,
) -> None:
    """Write the view of each of M observations.

    Args:
        tables: The task's tables.
        ground: uint8[cells], working memory, as are `stops`, `stop_at`, `distances`, `ways` and `rounds`.
        grids: uint8[M, cells], as the drones see them.
        drones: int64[M, 4]: cell, kind of the cell below, units left, steps left.
        counts: 1 if units count beside steps.
        view: Receives them.
    """
    view.begins[0] = 0
    pads = len(stops) - tables.deliveries
    for m in range(len(grids)):
        cell = drones[m, 0]
        parcels = 0
        for c in range(tables.cells):
            ground[c] = drones[m, 1] if c == cell else grids[m, c]
            stop_at[c] = NO_STOP
            if ground[c] == DELIVERY_CELL:
                stops[parcels] = c
                stop_at[c] = parcels
                parcels += 1
        n = parcels
        for c in range(tables.cells):
            if pads > 0 and ground[c] == PAD_CELL:
                stops[n] = c
                stop_at[c] = n
                n += 1
        for i in range(parcels):
            ground[stops[i]] = DELIVERED_CELL
        find_distances(tables, ground, stops[:n], counts, stop_at, distances, ways, rounds)
        for i in range(parcels):
            ground[stops[i]] = DELIVERY_CELL
        find_ways(tables, ground, cell, drones[m, 2], counts, stop_at, ways, 0, rounds)
        for t in range(n + 1, len(stops) + 1):
            view.present[m, t] = False
            for f in range(TOKEN_FEATURES):
                view.tokens[m, t, f] = 0.0
            for s in range(len(stops) + 1):
                for f in range(EDGE_FEATURES):
                    view.edges[m, s, t, f] = view.edges[m, t, s, f] = 0.0
        write_view(
            tables, stops[:n], parcels, 0, cell, drones[m, 2], drones[m, 3], counts, distances, ways, view, m
        )


class Viewer:
    """Turns observations of one task into views."""

    def __init__(self, task: TaskConfig, most: int = 256) -> None:
        self.task, self.most = task, most
        self.tables = tabulate(task)
        self._counts = int(counts_units(task))
        cells, pads = self.tables.cells, task.pads if self._counts and task.charge_rate else 0
        n = task.deliveries + pads
        self._ground, self._stop_at = np.zeros(cells, np.uint8), np.zeros(cells, np.int32)
        self._stops = np.zeros(n, np.int64)
        self._ways, self._rounds, self._distances = make_ways(task, n), make_rounds(task), make_distances(n)
        self._room = most * n * self._ways.units.shape[1]
        self._view = make_view(most, n, self._room)

    def __call__(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> View:
        """The views of M observations."""
        task, m = self.task, len(grids)
        drones = np.zeros((m, 4), np.int64)
        x, y = np.rint(telemetry[:, 0] * task.width), np.rint(telemetry[:, 1] * task.height)
        drones[:, 0] = y * task.width + x
        if task.telemetry_size > 6:
            drones[:, 1] = np.array(TERRAIN)[telemetry[:, 6:].argmax(axis=1)]
        drones[:, 2] = np.rint(telemetry[:, 2] * task.battery_capacity)
        left = np.rint(telemetry[:, 5] * task.max_steps) if task.telemetry_size > 5 else drones[:, 2]
        drones[:, 3] = left
        view_kernel(
            self.tables, self._ground, grids.reshape(m, -1), drones, self._counts, self._stops, self._stop_at,
            self._distances, self._ways, self._rounds, self._view,
        )
        v, o = self._view, self._view.begins[m]
        return View(v.tokens[:m], v.present[:m], v.edges[:m], v.begins[: m + 1], v.token[:o], v.features[:o], v.numbers[:o])
