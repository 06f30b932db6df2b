"""What a drone has around it, as entries of an embedding table, and the actions that do not bump; compiled.

Each stop, a waiting parcel or a pad, gives two entries. Both name its kind and the first action of the cheapest path to
it; one adds the cost of that path, the other what is spare on arrival. So a network need not search paths. A third one
may add how many parcels nearest neighbour delivers from there, in straight lines.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import N_ACTIONS, WAIT
from drone_env.core.cells import DELIVERY_CELL, N_CELL_KINDS, PAD_CELL, ROAD_CELL
from drone_env.core.compiled import jitable, kernel
from drone_env.core.rules import NONE, collision, manhattan
from drone_env.core.tables import N_MOVES, Tables, tabulate
from drone_env.core.tasks import TERRAIN, TaskConfig
from drone_env.planning.from_observation import drone_positions
from drone_env.planning.paths import NO_ACTION, NO_PATH, UNIT_COST, find_costs, move_costs, waits_until_full

EXACT, WIDTH, BUCKETS = 16, 4, 25
"""Numbers below `EXACT` have a bucket each, `WIDTH` larger ones share one. Bucket 0 is for negative numbers."""
BY_ACTION = N_ACTIONS * BUCKETS
COSTS = 1  # entry 0 is padding
SPARES = COSTS + 2 * BY_ACTION
UNITS = SPARES + 2 * BY_ACTION
NEIGHBOURS = UNITS + BUCKETS
ENTRIES = NEIGHBOURS + N_MOVES * N_CELL_KINDS
"""The first entry of each part, and the size of the table: cost of the path to a stop, spare units at it, units of the
battery, kinds of the cells beside the drone. The numbers are frozen: weights depend on them."""
ALL_ENTRIES = ENTRIES + 2 * BY_ACTION
"""The size of the table with deliveries from a stop on."""


@jitable
def bucket(number: int) -> int:
    """The bucket of a number, 0 to `BUCKETS` - 1."""
    if number < 0:
        return 0
    if number < EXACT:
        return number + 1
    return min(EXACT + 1 + (number - EXACT) // WIDTH, BUCKETS - 1)


@jitable
def deliveries_from(tables: Tables, cell: int, units: int, left: int, parcels: Any, n: int) -> int:
    """How many of n parcels nearest neighbour delivers from a cell, in straight lines over roads.

    It changes the order of `parcels`, int64[at least n], their cells. Ties go to the lowest cell.
    """
    for done in range(n):
        nearest, best = done, tables.cells**2
        for k in range(done, n):
            rank = manhattan(tables, cell, parcels[k]) * tables.cells + parcels[k]
            if rank < best:
                nearest, best = k, rank
        units, left = units - best // tables.cells, left - best // tables.cells
        if min(units, left) < 0:
            return done
        cell, parcels[nearest] = parcels[nearest], parcels[done]
        parcels[done] = cell
    return n


@kernel
def entries_kernel(
    tables: Tables, grounds: Any, drones: Any, kind_costs: Any, deliveries: Any, work: Any, entries: Any
) -> None:
    """Fill in the entries of N drones.

    Args:
        tables: The task's tables.
        grounds: uint8[N, cells], the kinds of the cells without the drones.
        drones: int64[N, 3], cell, units and steps left.
        kind_costs: int64[kinds], cost of a move onto each kind of cell.
        deliveries: Whether a stop has the entry of deliveries.
        work: int64[5, cells], working memory.
        entries: int32[N, at least all entries of one drone], zeros.
    """
    from_drone, first, to_pad, unused, parcels = work[0], work[1], work[2], work[3], work[4]
    moves: Any = tables.moves
    for i in range(len(grounds)):
        ground, drone, units, left = grounds[i], drones[i, 0], drones[i, 1], drones[i, 2]
        pads = waiting = 0
        for cell in range(tables.cells):
            from_drone[cell] = to_pad[cell] = NO_PATH
            first[cell] = unused[cell] = NO_ACTION
            if ground[cell] == PAD_CELL:
                to_pad[cell] = 0
                pads += 1
            elif ground[cell] == DELIVERY_CELL:
                parcels[waiting] = cell
                waiting += 1
        from_drone[drone] = 0
        find_costs(tables, ground, kind_costs, True, from_drone, first)
        if pads > 0 and waiting > 1:
            find_costs(tables, ground, kind_costs, True, to_pad, unused)
        entries[i, 0] = UNITS + bucket(units)
        n = 1
        for action in range(N_MOVES):
            to = moves[drone * N_ACTIONS + action]
            if collision(tables, ground, to) == NONE:
                entries[i, n] = NEIGHBOURS + action * N_CELL_KINDS + ground[to]
                n += 1
        for cell in range(tables.cells):
            is_parcel = ground[cell] == DELIVERY_CELL
            if from_drone[cell] == NO_PATH or not (is_parcel or ground[cell] == PAD_CELL):
                continue
            cost = from_drone[cell] // UNIT_COST
            spare = units - cost - 1  # the last unit ends the flight
            if is_parcel and pads > 0 and waiting > 1:
                # Found backwards: a move pays for the cell that it enters.
                back = to_pad[cell] - kind_costs[DELIVERY_CELL] + kind_costs[PAD_CELL]
                spare = spare - back // UNIT_COST if to_pad[cell] < NO_PATH else -1
            action = WAIT if cell == drone else first[cell]
            row = is_parcel * BY_ACTION + action * BUCKETS
            entries[i, n] = COSTS + row + bucket(cost)
            entries[i, n + 1] = SPARES + row + bucket(spare)
            n += 2
            if deliveries:
                after, later = units - cost, left - from_drone[cell] % UNIT_COST
                waits = waits_until_full(tables, after)
                if not is_parcel and after > 0 and waits > 0:
                    after, later = tables.capacity, later - waits
                entries[i, n] = ENTRIES + row + bucket(deliveries_from(tables, cell, after, later, parcels, waiting))
                n += 1


def entries_of(
    task: TaskConfig, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32], deliveries: bool = False
) -> npt.NDArray[np.int32]:
    """The entries of N observations, int32[N, 5 + 2 or 3 * (parcels + pads)]; 0 for those that are missing."""
    tables, n = tabulate(task), len(grids)
    x, y = drone_positions(task, grids, telemetry).T
    cells = y * task.width + x
    grounds = grids.reshape(n, -1).copy()
    shown: Any = np.array(TERRAIN)[telemetry[:, 6:].argmax(axis=1)] if task.pads else ROAD_CELL
    grounds[np.arange(n), cells] = shown
    units = np.rint(telemetry[:, 2] * task.battery_capacity).astype(np.int64)
    left = np.rint(telemetry[:, 5] * task.max_steps).astype(np.int64) if task.telemetry_size > 5 else units
    drones = np.stack([cells, units, left], axis=1)
    entries = np.zeros((n, entry_count(task, deliveries)), np.int32)
    work = np.zeros((5, tables.cells), np.int64)
    entries_kernel(tables, grounds, drones, move_costs(tables), deliveries, work, entries)
    return entries


def entry_count(task: TaskConfig, deliveries: bool) -> int:
    """The largest number of entries of a drone."""
    return 1 + N_MOVES + (2 + deliveries) * (task.deliveries + task.pads)


def action_masks(entries: npt.NDArray[np.int32]) -> npt.NDArray[np.bool_]:
    """The actions that do not bump, bool[N, 5], of the drones with these entries: as `info["action_mask"]`."""
    masks = np.zeros((len(entries), N_ACTIONS), np.bool_)
    masks[:, WAIT] = True
    drones, places = np.nonzero((entries >= NEIGHBOURS) & (entries < ENTRIES))
    masks[drones, (entries[drones, places] - NEIGHBOURS) // N_CELL_KINDS] = True
    return masks


def choices(
    entries: npt.NDArray[np.int32], full: Any, shield: bool = False, rush: bool = False
) -> npt.NDArray[np.bool_]:
    """The actions that PPO chooses from, bool[N, 5]: those that do not bump, or fewer.

    Args:
        entries: int32[N, L].
        full: bool[N], whether the battery is full.
        shield: Only first actions of the cheapest paths to stops that leave a pad within range, if there are any.
        rush: No waits that charge nothing, if another action is open.
    """
    masks = action_masks(entries)
    if rush:
        above_pad = (entries == COSTS + WAIT * BUCKETS + bucket(0)).any(axis=1)
        masks[:, WAIT] = above_pad & ~full | ~masks[:, :WAIT].any(axis=1)
    if shield:
        safe = np.zeros_like(masks)
        drones, places = np.nonzero((entries >= SPARES) & (entries < UNITS) & ((entries - SPARES) % BUCKETS > 0))
        safe[drones, (entries[drones, places] - SPARES) // BUCKETS % N_ACTIONS] = True
        masks = np.where(safe.any(axis=1, keepdims=True), safe, masks)
    return masks
