"""The exact value of every decision of a map, by legs: dynamic programming over (set delivered, stop, battery, steps).

All that matters on a flight is in which order it stops at parcels and pads, and by which way it flies from one to the
next. Between two stops only the undominated ways of `ways` can be part of a best flight; a parcel that still waits
ends a leg, since it is delivered there. So the values of the stops are enough: that of any other cell follows from the
ways that begin there. (Bellman, "Dynamic Programming", 1957; Held and Karp 1962 for the sets.)

It covers the tasks where a mission that fails is worth its parcels alone, and those where every step costs the same.
A value is kept as the rank of a score among all scores that the task knows, as in `exact`.
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
from drone_env.core.tasks import TaskConfig
from drone_env.planning.exact import ranked_scores
from drone_env.planning.ways import NO_STOP, Rounds, Ways, counts_units, find_ways, make_rounds, make_ways

WAIT = int(Action.WAIT)


def covers(task: TaskConfig) -> bool:
    """Whether the values of a task can be found by legs."""
    return task.uniform or task.efficiency_needs_all


class Legs(NamedTuple):
    """One map from a state of flight on, as the kernels see it. Stops: the parcels that waited then, then the pads."""

    tables: Tables
    counts: Any
    """1 if units count; 0 where every step drains one, and the battery is a part of the steps left."""
    ground: Any
    """uint8[cells], the kind of each cell without the drone; written to."""
    stops: Any
    """int64[N], the cell of each stop."""
    stop_at: Any
    """int32[cells], the number of the stop at each cell, or `NO_STOP`."""
    parcels: Any
    """How many of the stops are parcels, n."""
    most: Any
    """The most units that count."""
    ranks: Any
    """[rows, steps + 1], the rank of the highest score that can still be reached, by steps left: a row for each number
    of parcels delivered since then and units, where the flight ends for good (`end_row`), then one for each set
    delivered, stop and units (`row_of`). The rows of parcels that wait in the set, of the whole set and of 0 units
    hold nothing."""


def end_row(legs: Legs, done: int, units: int) -> int:
    """The row of ends with so many parcels delivered."""
    return done * (legs.most + 1) + units


def row_of(legs: Legs, delivered: int, stop: int, units: int) -> int:
    """The row of a drone that stands at a stop."""
    return (legs.parcels + 1 + delivered * len(legs.stops) + stop) * (legs.most + 1) + units


def mark_delivered(legs: Legs, delivered: int) -> int:
    """Write onto the ground which parcels wait, and return how many do not."""
    done = 0
    for i in range(legs.parcels):
        there = delivered >> i & 1
        done += there
        legs.ground[legs.stops[i]] = DELIVERED_CELL if there else DELIVERY_CELL
    return done


def row_after(legs: Legs, delivered: int, done: int, stop: int, units: int) -> int:
    """The row of a drone that arrives at a stop with so many units left."""
    if stop >= legs.parcels:
        return row_of(legs, delivered, stop, units) if units > 0 else end_row(legs, done, 0)
    if done + 1 == legs.parcels or units == 0:
        return end_row(legs, done + 1, units)
    return row_of(legs, delivered | 1 << stop, stop, units)


def raise_row(ranks: Any, row: int, after: int, steps: int) -> bool:
    """Raise a row to what another promises so many steps later; whether that changed any rank."""
    raised = False
    for left in range(steps, ranks.shape[1]):
        raised |= ranks[after, left - steps] > ranks[row, left]
        ranks[row, left] = max(ranks[row, left], ranks[after, left - steps])
    return raised


def raise_by_ways(
    legs: Legs, delivered: int, done: int, ways: Ways, base: int, units: int, row: int, first: int, behind: int
) -> bool:
    """Raise the row of a drone with so many units by the ways to the stops from `first` on and before `behind`."""
    raised = False
    for stop in range(first, behind):
        if stop < legs.parcels and delivered >> stop & 1:
            continue
        for k in range(ways.count[base + stop]):
            left = units - ways.units[base + stop, k]
            if left >= 0:
                after = row_after(legs, delivered, done, stop, left)
                raised |= raise_row(legs.ranks, row, after, ways.steps[base + stop, k])
    return raised


def begin_row(legs: Legs, done: int, units: int, row: int) -> None:
    """Let a row stand for a flight that does nothing more."""
    end = end_row(legs, done, units)
    for left in range(legs.ranks.shape[1]):
        legs.ranks[row, left] = legs.ranks[end, left]


for function in (end_row, row_of, mark_delivered, row_after, raise_row, raise_by_ways, begin_row):
    register_jitable(**compiled.OPTIONS)(function)
register_jitable(units_left)


@compiled_once(nogil=True, **compiled.OPTIONS)
def value_kernel(legs: Legs, ways: Ways, rounds: Rounds) -> None:
    """Fill in the ranks.

    Args:
        legs: The map.
        ways: Working memory: from a parcel, then from each pad, to every stop.
        rounds: Working memory.
    """
    n, stops = legs.parcels, len(legs.stops)
    charge = -legs.tables.drain[PAD_CELL * N_ACTIONS + WAIT]
    for delivered in range((1 << n) - 2, -1, -1):
        done = mark_delivered(legs, delivered)
        for pad in range(n, stops):
            base = (pad - n + 1) * stops
            find_ways(legs.tables, legs.ground, legs.stops[pad], legs.most, legs.counts, legs.stop_at, ways, base, rounds)
            for units in range(1, legs.most + 1):
                row = row_of(legs, delivered, pad, units)
                begin_row(legs, done, units, row)
                raise_by_ways(legs, delivered, done, ways, base, units, row, 0, n)
        changed = stops > n
        while changed:
            changed = False
            for pad in range(n, stops):
                base = (pad - n + 1) * stops
                for units in range(legs.most, 0, -1):
                    row = row_of(legs, delivered, pad, units)
                    charged = units_left(legs.tables, units, -charge)
                    if charged > units:
                        changed |= raise_row(legs.ranks, row, row_of(legs, delivered, pad, charged), 1)
                    changed |= raise_by_ways(legs, delivered, done, ways, base, units, row, n, stops)
        for parcel in range(n):
            if delivered >> parcel & 1:
                find_ways(
                    legs.tables, legs.ground, legs.stops[parcel], legs.most, legs.counts, legs.stop_at, ways, 0, rounds
                )
                for units in range(1, legs.most + 1):
                    row = row_of(legs, delivered, parcel, units)
                    begin_row(legs, done, units, row)
                    raise_by_ways(legs, delivered, done, ways, 0, units, row, 0, stops)


@compiled_once(nogil=True, **compiled.OPTIONS)
def rank_kernel(legs: Legs, delivered: int, cell: int, units: int, steps: int, ways: Ways, rounds: Rounds) -> Any:
    """The rank of the highest score that a drone can still reach from any cell."""
    done = mark_delivered(legs, delivered)
    find_ways(legs.tables, legs.ground, cell, units, legs.counts, legs.stop_at, ways, 0, rounds)
    best = legs.ranks[end_row(legs, done, units), steps]
    at = legs.stop_at[cell]
    if at >= legs.parcels:
        return max(best, legs.ranks[row_of(legs, delivered, at, units), steps])
    for stop in range(len(legs.stops)):
        for k in range(ways.count[stop]):
            left = steps - ways.steps[stop, k]
            if left >= 0 and not (stop < legs.parcels and delivered >> stop & 1):
                best = max(
                    best, legs.ranks[row_after(legs, delivered, done, stop, units - ways.units[stop, k]), left]
                )
    return best


class Solved:
    """prototype"""

    def __init__(self, task: TaskConfig, ground: npt.NDArray[np.uint8], parcels: list[int], done: int, battery: int, left: int):
        tables = tabulate(task)
        scores, ranked = ranked_scores(task)
        self.scores = scores
        counts = counts_units(task)
        pads = np.flatnonzero(ground == PAD_CELL) if counts and task.charge_rate else np.zeros(0, np.int64)
        stops = np.concatenate([np.array(parcels, np.int64), pads])
        stop_at = np.full(tables.cells, NO_STOP, np.int32)
        stop_at[stops] = np.arange(len(stops))
        n = len(parcels)
        if counts:
            self.units, self.left = task.battery_capacity, left
            ends = np.empty((n + 1, task.battery_capacity + 1, left + 1), ranked.dtype)
            ends[:n] = ranked[done : done + n, 0, task.max_steps][:, None, None]
            ends[n] = ranked[task.deliveries, :, task.max_steps - left :][:, ::-1]
        else:
            m = min(battery, left)
            self.units, self.left = 1, m
            ends = np.empty((n + 1, 2, m + 1), ranked.dtype)
            ends[:n] = ranked[done : done + n, battery - m, task.max_steps - left + m][:, None, None]
            later = np.arange(m + 1)
            ends[n] = ranked[task.deliveries, later + battery - m, task.max_steps - left + m - later]
        rows = ((n + 1) + (len(stops) << n)) * (self.units + 1)
        ranks = np.zeros((rows, self.left + 1), ranked.dtype)
        ranks[: (n + 1) * (self.units + 1)] = ends.reshape(-1, self.left + 1)
        self.legs = Legs(tables, int(counts), ground.copy(), stops, stop_at, n, self.units, ranks)
        self.ways, self.rounds = make_ways(task, len(stops) * (len(pads) + 1)), make_rounds(task)
        value_kernel(self.legs, self.ways, self.rounds)

    def value(self, delivered, cell, battery, left):
        units = battery if self.legs.counts else 1
        return self.scores[rank_kernel(self.legs, delivered, cell, units, left, self.ways, self.rounds)]
