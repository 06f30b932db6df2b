"""From observations to the views of the tour network (`tour_view`)."""

from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.agents.tour_view import (
    EDGE_FEATURES,
    OPTION_FEATURES,
    TOKEN_FEATURES,
    Distances,
    View,
    find_distances,
    make_distances,
    make_view,
    write_view,
)
from drone_env.core import compiled
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, PAD_CELL
from drone_env.core.compile_cache import compiled_once
from drone_env.core.tables import Tables, tabulate
from drone_env.core.tasks import TERRAIN, TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.planning.from_observation import drone_positions, hidden_kind
from drone_env.planning.paths import NO_STOP, counts_units
from drone_env.planning.paths import ParetoPaths as Ways
from drone_env.planning.paths import Workspace as Rounds
from drone_env.planning.paths import find_paths as find_ways
from drone_env.planning.paths import make_paths as make_ways
from drone_env.planning.paths import make_workspace as make_rounds
from drone_env.planning.states import require_memory

CHUNK = 256
"""Views at a time, so that what is worked on stays in the cache."""
CHUNK_BYTES = 1 << 25
"""Where a view is large they are fewer: all together take no more than this, unless a single one does."""
KEPT_BYTES = 1 << 24
"""What the distances take that are kept."""


@compiled_once(nogil=True, **compiled.OPTIONS)
def view_kernel(
    tables: Tables,
    grounds: Any,
    drones: Any,
    counts: int,
    pads: int,
    kept: Distances,
    places: Any,
    unknown: Any,
    ground: Any,
    sites: Any,
    stop_at: Any,
    distances: Distances,
    ways: Ways,
    rounds: Rounds,
    view: View,
) -> int:
    """Write the views of M observations; returns how many. It ends before one that shows too many parcels or pads.

    Args:
        tables: The task's tables.
        grounds: uint8[M, cells], without the drones.
        drones: int64[M, 3]: cell, units left, steps left.
        counts: 1 if units count beside steps.
        pads: How many pads a map has, 0 where they are no stops.
        kept: int32[places, N, N] each, the distances between all parcels, delivered or not, and pads of a map.
        places: int64[M], the place in `kept` of each state's map.
        unknown: bool[M], whether they have to be found first.
        ground: uint8[cells], working memory, as are the following.
        sites: int64[2, N]
        stop_at: int32[cells]
        distances: Between the stops of one state.
        ways: From its drone to them.
        rounds: Of the search.
        view: Receives them.
    """
    view.begins[0] = 0
    stops, numbers = sites
    room = len(stops)
    for m in range(len(grounds)):
        parcels = n = 0
        for c in range(tables.cells):
            kind = grounds[m, c]
            ground[c] = DELIVERED_CELL if kind == DELIVERY_CELL else kind
            stop_at[c] = NO_STOP
            if ground[c] == DELIVERED_CELL:
                if parcels == tables.deliveries:
                    return m
                stops[parcels] = c
                parcels += 1
        n = parcels
        for c in range(tables.cells):
            if pads > 0 and ground[c] == PAD_CELL:
                if n == parcels + pads:
                    return m
                stops[n] = c
                n += 1
        place = places[m]
        of_map = Distances(kept.cheap_units[place], kept.cheap_steps[place], kept.fast_steps[place])
        if unknown[m]:
            for i in range(n):
                stop_at[stops[i]] = i
            find_distances(tables, ground, stops[:n], counts, stop_at, of_map, ways, rounds)
        # From here on the parcels that wait, and the pads.
        stop, waiting = 0, 0
        for i in range(n):
            cell = stops[i]
            if i < parcels and grounds[m, cell] != DELIVERY_CELL:
                stop_at[cell] = NO_STOP
                continue
            ground[cell] = grounds[m, cell]
            waiting += i < parcels
            stops[stop] = cell
            stop_at[cell] = stop
            numbers[stop] = i
            stop += 1
        for i in range(stop):
            for j in range(stop):
                a, b = numbers[i], numbers[j]
                distances.cheap_units[i, j] = of_map.cheap_units[a, b]
                distances.cheap_steps[i, j] = of_map.cheap_steps[a, b]
                distances.fast_steps[i, j] = of_map.fast_steps[a, b]
        cell, units, left = drones[m]
        find_ways(tables, ground, cell, units, counts, stop_at, ways, 0, rounds)
        for t in range(stop + 1, room + 1):
            view.present[m, t] = False
            for f in range(TOKEN_FEATURES):
                view.tokens[m, t, f] = 0.0
            for s in range(room + 1):
                for f in range(EDGE_FEATURES):
                    view.edges[m, s, t, f] = view.edges[m, t, s, f] = 0.0
        write_view(tables, stops[:stop], waiting, 0, cell, units, left, counts, distances, ways, view, m)
    return len(grounds)


class Viewer:
    """Turns observations of one task into views. Not to be shared between threads.

    What lies between the stops of a map is kept from one call to the next: it depends on nothing that flies.

    Args:
        task: The task.

    Attributes:
        most: How many observations a call takes.

    Raises:
        TooLargeError: if a single view would take too much memory.
    """

    def __init__(self, task: TaskConfig) -> None:
        self._task, self._tables = task, tabulate(task)
        self._counts = counts_units(task)
        self._pads = task.pads if self._counts and task.charge_rate else 0
        cells, n = self._tables.cells, task.deliveries + self._pads
        self._ground, self._stop_at = np.zeros(cells, np.uint8), np.zeros(cells, np.int32)
        self._sites = np.zeros((2, n), np.int64)
        ways = make_ways(task, n)
        options = n * ways.units.shape[1]
        size = 4 * ((n + 1) ** 2 * EDGE_FEATURES + options * (OPTION_FEATURES + 4))
        require_memory("the view", task, size)
        self.most = max(1, min(CHUNK, CHUNK_BYTES // size))
        self._work = make_distances(n), ways, make_rounds(task)
        self._view = make_view(self.most, n, self.most * options)
        self._room = max(self.most, KEPT_BYTES // (12 * n * n)) if self._counts else self.most
        self._kept = Distances(*np.zeros((3, self._room, n, n), np.int32))
        self._place_of: dict[bytes, int] = {}

    def __call__(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> View:
        """The views of M observations, at most `most`: overwritten by the next call.

        Args:
            grids: uint8[M, height, width]
            telemetry: float32[M, telemetry_size]

        Raises:
            InvalidValueError: if they are no observations of the task: one shows more parcels, pads or battery than the
                task has, or a drone beside its grid.
        """
        drones = self._drones(grids, telemetry)
        most = self._task.battery_capacity, self._task.max_steps
        if not ((drones[:, 1:] >= 0) & (drones[:, 1:] <= most)).all():
            raise InvalidValueError(f"an observation has battery or steps left that {self._task.id!r} does not have")
        grounds = grids.reshape(len(grids), -1).copy()
        grounds[np.arange(len(grids)), drones[:, 0]] = self._below(grounds, telemetry)
        return self.views(grounds, drones)

    def views(self, grounds: npt.NDArray[np.uint8], drones: npt.NDArray[np.int64]) -> View:
        """The same of M states.

        Args:
            grounds: uint8[M, cells], without the drones.
            drones: int64[M, 3]: cell, units left, steps left.

        Raises:
            InvalidValueError: if one has more parcels or pads than the task.
        """
        m = len(grounds)
        places, unknown = self._places(grounds)
        written = view_kernel(
            self._tables, grounds, drones, int(self._counts), self._pads, self._kept, places, unknown,
            self._ground, self._sites, self._stop_at, *self._work, self._view,
        )  # fmt: skip
        if written < m:
            self._place_of.clear()
            raise InvalidValueError(f"an observation shows more parcels or pads than {self._task.id!r} has")
        view = self._view
        options = view.begins[m]
        return View(
            view.tokens[:m], view.present[:m], view.edges[:m], view.begins[: m + 1],
            view.token[:options], view.features[:options], view.numbers[:options],
        )  # fmt: skip

    def _drones(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """Cell, units left and steps left of each drone, int64[M, 3]."""
        task = self._task
        x, y = drone_positions(task, grids, telemetry).T
        units = np.rint(telemetry[:, 2] * task.battery_capacity)
        left = np.rint(telemetry[:, 5] * task.max_steps) if task.telemetry_size > 5 else units
        return np.stack([y * task.width + x, units, left], axis=1).astype(np.int64)

    def _below(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> Any:
        """The kinds of the cells below the drones; road where no kind makes a difference."""
        if self._task.telemetry_size > 6:
            return np.array(TERRAIN)[telemetry[:, 6:].argmax(axis=1)]
        return [hidden_kind(self._task, grid) for grid in grids] if self._counts else 0

    def _places(self, grounds: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
        """Where the distances of each map are kept, and whether they have to be found first."""
        m = len(grounds)
        if not self._counts:  # found faster than looked up
            return np.arange(m), np.ones(m, np.bool_)
        if len(self._place_of) + m > self._room:
            self._place_of.clear()
        places, unknown = np.zeros(m, np.int64), np.zeros(m, np.bool_)
        for i, ground in enumerate(np.where(grounds == DELIVERY_CELL, DELIVERED_CELL, grounds).astype(np.uint8)):
            new = len(self._place_of)
            places[i] = self._place_of.setdefault(ground.tobytes(), new)
            unknown[i] = places[i] == new
        return places, unknown
