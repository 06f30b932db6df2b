"""Heuristic plans: an order of stops at parcels and pads, flown on the cheapest paths. The drone fills up at each pad.

The rule is nearest neighbour with recharging, a construction heuristic of electric vehicle routing: fly to the nearest
parcel from which a pad is in range; else fill up at the pad on the cheapest chain of pads to such a parcel.
"""

import math
from string import ascii_uppercase
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import N_ACTIONS, WAIT, Action, Event
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, PAD_CELL
from drone_env.core.compiled import jitable, kernel
from drone_env.core.episode import Episode
from drone_env.core.rules import score_of
from drone_env.core.tables import N_MOVES, Tables, tabulate
from drone_env.planning.paths import (
    NO_ACTION,
    NO_PATH,
    UNIT_COST,
    find_costs,
    least_units,
    move_costs,
    waits_until_full,
)
from drone_env.planning.states import require_memory, state_arrays

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
    through: Any
    """Whether paths lead on beyond waiting parcels, which they deliver; else they end there."""
    costs: Any
    """int64[N + 1, cells], the cost of the cheapest path from each place to each cell."""
    units: Any
    """int64[N + 1, N], the battery units of the cheapest path between places, `FAR` if there is none."""
    steps: Any
    """int64[N + 1, N], its steps."""
    passed: Any
    """int64[N + 1, N], the parcels that it delivers, bit i for parcel i."""
    reserves: Any
    """int64[2, parcels], the units that a drone needs on arrival: to deliver, and to fly on to a pad as well."""
    chains: Any
    """int64[2, N, parcels], the units from each pad, left full, by way of others to each parcel, for each reserve."""


class NextStop(NamedTuple):
    """A stop that a drone can reach: it flies the cheapest path and, on a pad, fills up."""

    label: str
    """`A`, `B` and so on: first the parcels, by index, then the pads, by cell. A stop keeps it for the whole flight."""
    is_parcel: bool
    cell: int
    actions: list[Action]
    """The path and the waits."""
    cost: int
    """Battery units of the path."""
    spare: int
    """Units left on arrival above those for the way on to a pad, if a parcel remains. Of a pad: those at the parcel
    after it that leaves most. Negative if no pad is in range then."""
    next: int | None
    """Units of the cheapest path from there to another waiting parcel; None if there is none."""


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
        if neighbour >= stops.tables.cells or costs[neighbour] != before:
            continue
        if stops.through or before == 0 or stops.ground[neighbour] != DELIVERY_CELL:
            return neighbour, action
    return cell, NO_ACTION


@jitable
def find_chains(stops: StopMap) -> None:
    """Find the reserves, and the chains of pads to each parcel (Bellman-Ford)."""
    n, end, capacity = stops.parcels, len(stops.cells) - 1, stops.tables.capacity
    for parcel in range(n):
        home = FAR if end > n else 0
        for pad in range(n, end):
            home = min(home, stops.units[parcel, pad])
        stops.reserves[0, parcel] = least_units(stops.tables, True)
        stops.reserves[1, parcel] = home + 1
        for kind in range(2):
            chains, changed = stops.chains[kind], True
            for pad in range(n, end):
                units = stops.units[pad, parcel]
                chains[pad, parcel] = units if capacity - units >= stops.reserves[kind, parcel] else FAR
            while changed:
                changed = False
                for pad in range(n, end):
                    for other in range(n, end):
                        units = stops.units[pad, other]
                        if units < capacity and units + chains[other, parcel] < chains[pad, parcel]:
                            chains[pad, parcel], changed = units + chains[other, parcel], True


@jitable
def measure(stops: StopMap, place: int, first: Any) -> None:
    """Measure the distances from a place to each stop; `first` is working memory, int64[cells]."""
    costs = stops.costs[place]
    costs[:] = NO_PATH
    first[:] = NO_ACTION
    costs[stops.cells[place]] = 0
    find_costs(stops.tables, stops.ground, stops.kind_costs, stops.through, costs, first)
    for stop in range(len(stops.cells) - 1):
        cost = costs[stops.cells[stop]]
        stops.units[place, stop] = cost // UNIT_COST if cost < NO_PATH else FAR
        stops.steps[place, stop] = cost % UNIT_COST if cost < NO_PATH else FAR


@kernel
def measure_kernel(stops: StopMap, first: Any) -> None:
    """Measure the distances between all places; `first` is working memory, int64[cells]."""
    cells, n = stops.cells, stops.parcels
    for place in range(len(cells)):
        measure(stops, place, first)
        for stop in range(len(cells) - 1):
            cost, passed = stops.costs[place, cells[stop]], 1 << stop if stop < n else 0
            cell = cells[stop]
            while cost < NO_PATH and cell != cells[place]:
                if stops.ground[cell] == DELIVERY_CELL:
                    for parcel in range(n):
                        passed |= (cells[parcel] == cell) << parcel
                cell, _ = step_back(stops, place, cell)
            stops.passed[place, stop] = passed
    find_chains(stops)


@jitable
def nearest_stop(stops: StopMap, flight: Flight, returns: int) -> int:
    """The next stop by the rule, or `NO_STOP`. A drone that `returns` keeps a pad in range up to the last parcel."""
    n, place, best, lowest = stops.parcels, flight.place, NO_STOP, FAR
    waiting = (1 << n) - 1 - flight.delivered
    kind = returns if waiting & (waiting - 1) else 0
    for parcel in range(n):
        units = stops.units[place, parcel]
        in_time = stops.steps[place, parcel] <= flight.left
        in_range = flight.units - units >= stops.reserves[kind, parcel]
        if waiting >> parcel & 1 and units < lowest and in_time and in_range:
            best, lowest = parcel, units
    if best != NO_STOP:
        return best
    for pad in range(n, len(stops.cells) - 1):
        units = 0 if pad == place else stops.units[place, pad]
        for parcel in range(n):
            chain = units + stops.chains[kind, pad, parcel]
            if waiting >> parcel & 1 and chain < lowest and fly_to(stops, flight, pad).left < flight.left:
                best, lowest = pad, chain
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
        possible = left >= 0 and units >= least_units(stops.tables, True)
        return Flight(delivered, stop, max(units, 0), left) if possible else flight
    waits = waits_until_full(stops.tables, units)
    if units <= 0 or left < waits or delivered == (1 << stops.parcels) - 1:
        return flight  # the last delivery ends the flight
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


@jitable
def score_at(stops: StopMap, flight: Flight) -> float:
    """The score of a planned flight at its end."""
    tables, waiting = stops.tables, 0
    for parcel in range(stops.parcels):
        waiting += 1 - (flight.delivered >> parcel & 1)
    if waiting:  # only waiting remains
        return score_of(tables, tables.deliveries - waiting, 0, tables.max_steps)
    return score_of(tables, tables.deliveries, flight.units, tables.max_steps - flight.left)


@jitable
def flight_of(row: Any) -> Flight:
    """The flight in the first columns of a row of a beam."""
    return Flight(row[0], row[1], row[2], row[3])


@jitable
def is_dominated(flight: Flight, rows: Any, n: int) -> bool:
    """Whether one of the first n rows has as many units and steps left, at the same place with the same parcels."""
    for i in range(n):
        other = flight_of(rows[i])
        same = other.delivered == flight.delivered and other.place == flight.place
        if same and other.units >= flight.units and other.left >= flight.left:
            return True
    return False


@jitable
def copy(values: Any, to: Any, n: int) -> None:
    """Copy the first n values; slices would allocate."""
    for i in range(n):
        to[i] = values[i]


@kernel
def beam_kernel(stops: StopMap, start: Any, beams: Any, scores: Any, best: Any, order: Any) -> int:
    """Write the stops of the best flight found to `best`, and return their number.

    A beam has the best partial flights with the same number of stops. Flights that nearest neighbour completes to
    higher scores are better.

    Args:
        stops: The map.
        start: int64[4], the fields of the first flight.
        beams: int64[2, width, 4 + most stops], working memory: flights and their stops so far.
        scores: float64[width], working memory.
        best: int64[stops], receives the stops.
        order: int64[stops], working memory.
    """
    n, everything = len(stops.cells) - 1, (1 << stops.parcels) - 1
    end, n_best = fly_by_rule(stops, flight_of(start), best)
    highest = score_at(stops, end)
    copy(start, beams[0, 0], 4)
    kept, width = 1, len(scores)
    for depth in range(4, beams.shape[2]):
        beam, children, n_children = beams[depth % 2], beams[1 - depth % 2], 0
        for k in range(kept):
            flight = flight_of(beam[k])
            for stop in range(n):
                if stop < stops.parcels and flight.delivered >> stop & 1:
                    continue
                child = fly_to(stops, flight, stop)
                if child.left == flight.left or is_dominated(child, children, n_children):
                    continue
                if score_at(stops, Flight(everything, stop, stops.tables.capacity, child.left)) <= highest:
                    continue  # no flight from here is better
                end, n_stops = fly_by_rule(stops, child, order)
                score = score_at(stops, end)
                if score > highest:
                    highest, n_best = score, depth - 3 + n_stops
                    copy(beam[k, 4:], best, depth - 4)
                    best[depth - 4] = stop
                    copy(order, best[depth - 3 :], n_stops)
                if child.delivered == everything or child.units == 0:
                    continue
                if n_children == width and score <= scores[width - 1]:
                    continue
                n_children = min(n_children + 1, width)
                at = n_children - 1
                while at > 0 and scores[at - 1] < score:
                    scores[at] = scores[at - 1]
                    copy(children[at - 1], children[at], depth + 1)
                    at -= 1
                scores[at] = score
                copy(child, children[at], 4)
                copy(beam[k, 4:], children[at, 4:], depth - 4)
                children[at, depth] = stop
        kept = n_children
        if kept == 0:
            break
    return n_best


@kernel
def stop_value_kernel(stops: StopMap, first: Any, values: Any) -> None:
    """Compute the highest score by stops from each state, if no path leads on beyond a waiting parcel.

    Args:
        stops: The map; its ground and its distances between stops are modified.
        first: int64[cells], working memory.
        values: float64[sets delivered, stops, units + 1, steps left + 1], receives the scores.
    """
    n, n_stops, capacity = stops.parcels, values.shape[1], stops.tables.capacity
    for delivered in range(len(values) - 1, -1, -1):
        for parcel in range(n):
            stops.ground[stops.cells[parcel]] = DELIVERED_CELL if delivered >> parcel & 1 else DELIVERY_CELL
        for place in range(n_stops):
            measure(stops, place, first)
        for left in range(values.shape[3]):  # each stop takes a step at least
            for place in range(n_stops):
                if place < n and not delivered >> place & 1:
                    continue
                for charge in range(0 if place < n else capacity, capacity + 1):
                    flight = Flight(delivered, place, charge, left)
                    best = score_at(stops, flight)
                    for stop in range(n_stops):
                        if charge == 0 or (stop < n and delivered >> stop & 1):
                            continue
                        after = fly_to(stops, flight, stop)
                        if after.left < left:
                            best = max(best, values[after.delivered, after.place, after.units, after.left])
                    values[delivered, place, charge, left] = best


@kernel
def route_kernel(stops: StopMap, flight: Flight, order: Any, actions: Any) -> int:
    """Write the actions of a flight to these stops, int64[steps], and return their number."""
    n = 0
    for stop in order:
        cell, start = stops.cells[stop], stops.cells[flight.place]
        arrival = n + (stops.costs[flight.place, cell] % UNIT_COST if cell != start else 0)
        after = fly_to(stops, flight, stop)
        n += flight.left - after.left
        actions[arrival:n] = WAIT
        while cell != start:
            cell, action = step_back(stops, flight.place, cell)
            arrival -= 1
            actions[arrival] = action
        flight = after
    return n


def measure_stops(episode: Episode, through: bool) -> tuple[StopMap, Flight]:
    """The map of an episode, and its flight so far.

    Args:
        episode: The episode; it is not changed.
        through: Whether paths lead on beyond waiting parcels.

    Raises:
        TooLargeError: if the map would take more memory than `states.MAX_BYTES`.
    """
    task, (ground, _, _) = episode.task, state_arrays(episode)
    tables, parcels = tabulate(task), np.flatnonzero(ground == DELIVERY_CELL)
    pads = np.flatnonzero(ground == PAD_CELL) if task.charge_rate and not task.uniform else parcels[:0]
    places, n = np.concatenate([parcels, pads, [episode.cell]]), len(parcels)
    p = len(places)
    require_memory("the distances", task, 8 * p * (tables.cells + 3 * p + 2 * n))
    costs, (units, steps, passed) = np.zeros((p, tables.cells), np.int64), np.zeros((3, p, p - 1), np.int64)
    reserves, chains = np.zeros((2, n), np.int64), np.zeros((2, p, n), np.int64)
    stops = StopMap(
        tables, ground, move_costs(tables), places, n, through, costs, units, steps, passed, reserves, chains
    )
    measure_kernel(stops, np.zeros(tables.cells, np.int64))
    return stops, Flight(0, p - 1, episode.battery_units, task.max_steps - episode.steps)


def planned_actions(episode: Episode, width: int) -> npt.NDArray[np.int64]:
    """Plan a flight by beam search, or, if `width` is 0, by nearest neighbour with recharging.

    Args:
        episode: An episode in flight; it is not changed.
        width: Partial flights to keep after each stop.

    Returns:
        The actions, int64[steps]. If the episode has not ended after them, only waiting remains.
    """
    stops, start = measure_stops(episode, through=True)
    best, order = np.zeros((2, 2 * start.left + 2), np.int64)
    most = 2 * stops.parcels + 4 if width else 0
    beams, scores = np.zeros((2, max(width, 1), 4 + most), np.int64), np.zeros(width)
    n = beam_kernel(stops, np.array(start), beams, scores, best, order)
    actions = np.zeros(start.left, np.int64)
    return actions[: route_kernel(stops, start, best[:n], actions)]


def next_stops(episode: Episode) -> list[NextStop]:
    """The stops that a drone can fly to: the parcels, then the pads, the cheapest first.

    A way delivers no other parcel. Pads that the drone has left full since the last delivery are left out, unless
    nothing else is in reach.

    Raises:
        TooLargeError: as `measure_stops`.
    """
    if episode.ended:
        return []
    stops, start = measure_stops(episode, through=False)
    cells = [y * episode.task.width + x for x, y, _ in episode.parcels] + stops.cells[stops.parcels : -1].tolist()
    left_full, found, repeated = _left_full(episode), list[NextStop](), list[NextStop]()
    for stop in sorted(range(start.place), key=lambda stop: (stop >= stops.parcels, stops.units[start.place, stop])):
        after = fly_to(stops, start, stop)
        if after.left == start.left:
            continue
        cell, actions = int(stops.cells[stop]), np.zeros(start.left, np.int64)
        n = route_kernel(stops, start, np.array([stop]), actions)
        way = list(map(Action, actions[:n].tolist()))
        facts = (int(stops.units[start.place, stop]), *_outlook(stops, after))
        option = NextStop(_label(cells.index(cell)), stop < stops.parcels, cell, way, *facts)
        (repeated if cell in left_full else found).append(option)
    return found or repeated


def stop_values(episode: Episode) -> dict[str, float]:
    """The highest score that can still be reached by stops after each of `next_stops`, by label.

    Raises:
        TooLargeError: as `measure_stops`, or if the values of all states take too much memory.
    """
    found = next_stops(episode)
    if not found:
        return {}
    stops, start = measure_stops(episode, through=False)
    places, shape = stops.cells.tolist(), (1 << stops.parcels, start.place, stops.tables.capacity + 1, start.left + 1)
    ends = {stop.label: fly_to(stops, start, places.index(stop.cell)) for stop in found}
    require_memory("the values of stops", episode.task, 8 * math.prod(shape))
    values = np.zeros(shape)
    stop_value_kernel(stops, np.zeros(stops.tables.cells, np.int64), values)
    return {label: float(values[at.delivered, at.place, at.units, at.left]) for label, at in ends.items()}


def _left_full(episode: Episode) -> set[int]:
    """The cells at which the battery has been full since the last delivery."""
    cells, task = set[int](), episode.task
    for step in reversed(episode.path):
        if step.event is Event.DELIVERY:
            break
        if step.battery == task.battery_capacity:
            cells.add(step.y * task.width + step.x)
    return cells


def _outlook(stops: StopMap, after: Flight) -> tuple[int, int | None]:
    """The `spare` and `next` of a `NextStop`, given the flight on arrival."""
    n, place, capacity = stops.parcels, after.place, stops.tables.capacity
    waiting = [parcel for parcel in range(n) if not after.delivered >> parcel & 1]
    ways = {parcel: int(stops.units[place, parcel]) for parcel in waiting if stops.units[place, parcel] < FAR}
    if place >= n:
        reserves = stops.reserves[int(len(waiting) > 1)]
        spare = max((capacity - units - reserves[parcel] for parcel, units in ways.items()), default=-capacity)
    else:
        spare = after.units - (stops.reserves[1, place] if waiting and len(stops.cells) > n + 1 else 0)
    return max(int(spare), -capacity), min(ways.values(), default=None)


def _label(number: int) -> str:
    """`A` to `Z`, then `AA`, `BB` and so on."""
    rounds, letter = divmod(number, len(ascii_uppercase))
    return ascii_uppercase[letter] * (rounds + 1)
