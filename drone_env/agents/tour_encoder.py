"""From observations to the features of the tour network (`tour_features`)."""

from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.agents.tour_features import (
    EDGE_FEATURES,
    OPTION_FEATURES,
    Distances,
    Features,
    PathSearch,
    find_distances,
    first_states,
    make_features,
    make_search,
    search_paths,
    write_features,
)
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, PAD_CELL
from drone_env.core.compiled import kernel
from drone_env.core.tasks import TERRAIN, TaskConfig
from drone_env.errors import InvalidValueError
from drone_env.planning.from_observation import drone_positions, hidden_kind
from drone_env.planning.paths import NO_STOP, counts_units
from drone_env.planning.states import require_memory

CHUNK = 256
"""Maximum number of states per call: their features fit into the processor's cache."""
CHUNK_BYTES = 1 << 25
"""Maximum size of their features, unless a single state takes more."""
CACHE_BYTES = 1 << 24
"""Size of the cache of distances, unless those of a chunk take more."""


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
        search_paths(search, cell, units)
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
        self._task, self._counts = task, counts_units(task)
        self._pads = task.pads if self._counts and task.charge_rate else 0
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
        drones = self._drones(grids, telemetry)
        most = self._task.battery_capacity, self._task.max_steps
        if not ((drones[:, 1:] >= 0) & (drones[:, 1:] <= most)).all():
            raise InvalidValueError(f"an observation has battery or steps left that {self._task.id!r} does not have")
        grounds = grids.reshape(len(grids), -1).copy()
        grounds[np.arange(len(grids)), drones[:, 0]] = self._below(grounds, telemetry)
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

    def _drones(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """Cell, units left and steps left of each drone, int64[M, 3]."""
        task = self._task
        x, y = drone_positions(task, grids, telemetry).T
        units = np.rint(telemetry[:, 2] * task.battery_capacity)
        left = np.rint(telemetry[:, 5] * task.max_steps) if task.telemetry_size > 5 else units
        return np.stack([y * task.width + x, units, left], axis=1).astype(np.int64)

    def _below(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> Any:
        """The kinds of the cells below the drones; road if the kind makes no difference."""
        if self._task.telemetry_size > 6:
            return np.array(TERRAIN)[telemetry[:, 6:].argmax(axis=1)]
        return [hidden_kind(self._task, grid) for grid in grids] if self._counts else 0
