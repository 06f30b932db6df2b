"""Heuristic plans: an order of stops at parcels and pads, flown on the cheapest paths. The drone fills up at each pad.

The rule is nearest neighbour with recharging, a construction heuristic of electric vehicle routing: fly to the nearest
parcel from which a pad is in range; else fill up at the pad on the cheapest chain of pads to such a parcel.
"""

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import N_ACTIONS, Action
from drone_env.core.cells import DELIVERY_CELL, PAD_CELL
from drone_env.core.compiled import jitable, kernel
from drone_env.core.rules import units_left
from drone_env.core.tables import N_MOVES, Tables, tabulate
from drone_env.core.tasks import TaskConfig
from drone_env.planning.paths import NO_ACTION, NO_PATH, UNIT_COST, find_costs, move_costs
from drone_env.planning.states import require_memory

WAIT = int(Action.WAIT)
FAR = 1 << 30
NO_STOP = -1


class StopMap(NamedTuple):
    """A map with N stops: the waiting parcels, then the pads. The drone starts at place N."""

    tables: Tables
    ground: Any
    """uint8[cells], without the drone."""
    kind_costs: Any
    """int64[kinds], the cost of a move onto each kind of cell."""
    cells: Any
    """int64[N + 1], the cell of each place."""
    parcels: Any
    """Number of stops that are parcels."""
    costs: Any
    """int64[N + 1, cells], the cost of the cheapest path from each place to each cell."""
    units: Any
    """int64[N + 1, N], the battery units of the cheapest path between places, `FAR` if there is none."""
    steps: Any
    """int64[N + 1, N], its steps."""
    passed: Any
    """int64[N + 1, N], the parcels that it delivers, bit i for parcel i."""
    home: Any
    """int64[N], units from each stop to the nearest pad; 0 if there are no pads."""
    lead: Any
    """int64[N], working memory: units from each pad to the next parcel, in a chain of pads."""


class Flight(NamedTuple):
    """A state of a planned flight between two stops."""

    delivered: Any
    """Bit i for parcel i."""
    place: Any
    """Number of the stop, or N."""
    units: Any
    """Battery units left."""
    left: Any
    """Steps left."""


@jitable
def step_back(stops: StopMap, place: int, cell: int) -> tuple[int, int]:
    """The cell before a cell on the cheapest path from a place, and the action that leads from it to the cell."""
    costs, moves = stops.costs[place], stops.tables.moves
    before = costs[cell] - stops.kind_costs[stops.ground[cell]]
    for action in range(N_MOVES):
        # The opposite of a move differs in the last bit.
        neighbour = moves[cell * N_ACTIONS + (action ^ 1)]
        if neighbour < stops.tables.cells and costs[neighbour] == before:
            return neighbour, action
    return cell, NO_ACTION


@kernel
def measure_kernel(stops: StopMap, first: Any) -> None:
    """Measure the distances between all places; `first` is working memory, int64[cells]."""
    tables, cells, n = stops.tables, stops.cells, stops.parcels
    for place in range(len(cells)):
        costs = stops.costs[place]
        costs[:] = NO_PATH
        first[:] = NO_ACTION
        costs[cells[place]] = 0
        find_costs(tables, stops.ground, stops.kind_costs, costs, first)
        for stop in range(len(cells) - 1):
            cost, passed = costs[cells[stop]], 0
            stops.units[place, stop] = cost // UNIT_COST if cost < NO_PATH else FAR
            stops.steps[place, stop] = cost % UNIT_COST if cost < NO_PATH else FAR
            cell = cells[stop]
            while cost < NO_PATH and cell != cells[place]:
                if stops.ground[cell] == DELIVERY_CELL:
                    for parcel in range(n):
                        passed |= (cells[parcel] == cell) << parcel
                cell, _ = step_back(stops, place, cell)
            stops.passed[place, stop] = passed
    for stop in range(len(cells) - 1):
        stops.home[stop] = FAR if n < len(cells) - 1 else 0
        for pad in range(n, len(cells) - 1):
            stops.home[stop] = min(stops.home[stop], stops.units[stop, pad])


@jitable
def reserve(stops: StopMap, delivered: int, parcel: int, returns: int) -> int:
    """The lowest number of units with which the drone may arrive at a parcel.

    The last parcel may take the last unit, or even more. From others, if the drone `returns`, a pad is in range.
    """
    if delivered | 1 << parcel == (1 << stops.parcels) - 1 or not returns:
        return 1 - stops.tables.drain[DELIVERY_CELL * N_ACTIONS]
    return stops.home[parcel] + 1


@jitable
def nearest_stop(stops: StopMap, flight: Flight, returns: int) -> int:
    """The next stop by the rule, or `NO_STOP`; a drone that `returns` does not strand before the last parcel."""
    n, end, capacity = stops.parcels, len(stops.cells) - 1, stops.tables.capacity
    place, units = flight.place, flight.units
    best, nearest = NO_STOP, FAR
    for parcel in range(n):
        far = stops.units[place, parcel]
        if flight.delivered >> parcel & 1 or far >= nearest or stops.steps[place, parcel] > flight.left:
            continue
        if units - far >= reserve(stops, flight.delivered, parcel, returns):
            best, nearest = parcel, far
    if best != NO_STOP:
        return best
    for pad in range(n, end):
        stops.lead[pad] = FAR
        for parcel in range(n):
            far = stops.units[pad, parcel]
            if not flight.delivered >> parcel & 1 and capacity - far >= reserve(
                stops, flight.delivered, parcel, returns
            ):
                stops.lead[pad] = min(stops.lead[pad], far)
    changed = True
    while changed:
        changed = False
        for pad in range(n, end):
            for other in range(n, end):
                chained = stops.units[pad, other] + stops.lead[other]
                if stops.units[pad, other] < capacity and chained < stops.lead[pad]:
                    stops.lead[pad], changed = chained, True
    for pad in range(n, end):
        far = 0 if pad == place else stops.units[place, pad]
        if far + stops.lead[pad] < nearest and fly_to(stops, flight, pad).left < flight.left:
            best, nearest = pad, far + stops.lead[pad]
    return best


@jitable
def fly_to(stops: StopMap, flight: Flight, stop: int) -> Flight:
    """The flight after the cheapest path to a stop and, on a pad, a full charge; unchanged if that is impossible."""
    delivered, place, units, left = flight
    if stop != place:
        units -= stops.units[place, stop]
        left -= stops.steps[place, stop]
        delivered |= stops.passed[place, stop]
    if stop < stops.parcels:
        possible = left >= 0 and units > -stops.tables.drain[DELIVERY_CELL * N_ACTIONS]
        return Flight(delivered, stop, max(units, 0), left) if possible else flight
    charge = -stops.tables.drain[PAD_CELL * N_ACTIONS + WAIT]
    waits = (stops.tables.capacity - units + charge - 1) // charge
    if units <= 0 or left < waits:
        return flight
    return Flight(delivered, stop, stops.tables.capacity, left - waits)


@jitable
def fly_by_rule(stops: StopMap, flight: Flight, order: Any) -> tuple[Any, int]:
    """Fly by the rule to the end of the flight; write the stops to `order` and return the end and their number."""
    n_stops, everything = 0, (1 << stops.parcels) - 1
    for returns in range(1, -1, -1):
        while flight.delivered != everything and flight.units > 0 and flight.left > 0:
            stop = nearest_stop(stops, flight, returns)
            if stop == NO_STOP:
                break
            flight = fly_to(stops, flight, stop)
            order[n_stops] = stop
            n_stops += 1
    return flight, n_stops


@kernel
def rule_kernel(stops: StopMap, units: int, left: int, order: Any) -> int:
    """Write the stops of a flight by the rule to `order`, and return their number."""
    _, n_stops = fly_by_rule(stops, Flight(0, len(stops.cells) - 1, units, left), order)
    return n_stops


@kernel
def trace_kernel(stops: StopMap, order: Any, units: int, left: int, flown: Any) -> int:
    """Write each step of a flight to these stops, int64[steps, 4]: cell, units left, steps left, action; return the
    number of steps."""
    tables, place, steps = stops.tables, len(stops.cells) - 1, 0
    charge = int(tables.drain[PAD_CELL * N_ACTIONS + WAIT])
    for stop in order:
        cell, start = stops.cells[stop], stops.cells[place]
        arrival = steps + stops.costs[place, cell] % UNIT_COST if cell != start else steps
        if arrival > left:
            break
        steps = arrival
        while cell != start:
            cell, action = step_back(stops, place, cell)
            arrival -= 1
            flown[arrival, 0], flown[arrival, 3] = cell, action
            flown[arrival, 1], flown[arrival, 2] = units - stops.costs[place, cell] // UNIT_COST, left - arrival
        units = max(units - stops.costs[place, stops.cells[stop]] // UNIT_COST, 0)
        while stop >= stops.parcels and units < tables.capacity and steps < left:
            flown[steps] = stops.cells[stop], units, left - steps, WAIT
            units = units_left(tables, units, charge)
            steps += 1
        place = stop
    return steps


def measure_stops(task: TaskConfig, ground: npt.NDArray[np.uint8], drone: int) -> StopMap:
    """Measure a map.

    Args:
        task: The task.
        ground: uint8[cells], without the drone.
        drone: The cell of the drone.

    Raises:
        TooLargeError: if the map would take more memory than `states.MAX_BYTES`.
    """
    tables = tabulate(task)
    parcels = np.flatnonzero(ground == DELIVERY_CELL)
    pads = np.flatnonzero(ground == PAD_CELL) if task.charge_rate and not task.uniform else parcels[:0]
    n = len(parcels) + len(pads)
    require_memory("the distances", task, 8 * (n + 1) * (tables.cells + 3 * n))
    costs, distances = np.empty((n + 1, tables.cells), np.int64), np.zeros((3, n + 1, n), np.int64)
    cells = np.concatenate([parcels, pads, [drone]])
    stops = StopMap(
        tables, ground, move_costs(tables), cells, len(parcels), costs, *distances, *np.zeros((2, n), np.int64)
    )
    measure_kernel(stops, np.empty(tables.cells, np.int64))
    return stops
