"""The ways over a map that are worth flying, from one cell to stops (parcels and pads).

A way that costs fewer battery units may take more steps, and the other way round; one that is no better in either is
never worth flying. Labels are corrected in rounds, one step a round (Bellman, "On a routing problem", 1958; two
criteria: Hansen, "Bicriterion path problems", 1980).
"""

from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core import compiled
from drone_env.core.actions import N_ACTIONS
from drone_env.core.cells import DELIVERY_CELL
from drone_env.core.obstacles import NONE, collision
from drone_env.core.tables import N_MOVES, Tables
from drone_env.core.tasks import TaskConfig

UNREACHED = 1 << 30
NO_STOP = -1


class Ways(NamedTuple):
    """The ways to N stops, from one cell or from several: all undominated pairs of units and steps.

    They are in the order of rising steps and falling units: the first is the fastest, the last the cheapest.
    """

    count: Any
    """int64[N], how many there are."""
    units: Any
    """int32[N, most ways], battery units that they drain; the last step may ask for more than is left."""
    steps: Any
    """int32[N, most ways], the steps that they take."""
    first: Any
    """int32[N, most ways], the action that they begin with."""


class Rounds(NamedTuple):
    """Working memory of `find_ways`: of each cell, and of those that the last round and this one have reached."""

    fewest: Any
    """int32[cells], units of the cheapest way so far."""
    action: Any
    """int32[cells], the action that it begins with."""
    reached_in: Any
    """int32[cells], the last round that found a cheaper way."""
    last: Any
    """int32[3, cells]: cell, units and first action."""
    next: Any
    """int32[3, cells]"""


def make_ways(task: TaskConfig, stops: int) -> Ways:
    """Room for the ways to this many stops."""
    return Ways(np.zeros(stops, np.int64), *np.zeros((3, stops, most_ways(task)), np.int32))


def most_ways(task: TaskConfig) -> int:
    """How many ways to one stop there can be."""
    # Of n ways each takes a step more and a unit less than the one before.
    return min(task.battery_capacity + 1, task.width * task.height) if counts_units(task) else 1


def make_rounds(task: TaskConfig) -> Rounds:
    """Working memory for a map of the task."""
    cells = task.width * task.height
    return Rounds(*np.zeros((3, cells), np.int32), *np.zeros((2, 3, cells), np.int32))


def counts_units(task: TaskConfig) -> bool:
    """Whether units are worth counting beside steps: not where each step drains one, whatever it is."""
    return not task.uniform


def find_ways(
    tables: Tables, ground: Any, start: int, most: int, counts: int, stop_at: Any, ways: Ways, base: int, rounds: Rounds
) -> None:
    """Find all undominated ways from a cell to each stop. A parcel that still waits ends a way: it is delivered there.

    Args:
        tables: The task's tables.
        ground: uint8[cells], the kind of each cell, without the drone; a parcel waits where it is `Cell.DELIVERY`.
        start: The cell that they begin at.
        most: Units of the drone: a way leaves some of them, or takes the last with the step to a parcel that waits.
        counts: 1 if units count, 0 if only steps do: a way then drains none.
        stop_at: int32[cells], the number of the stop at each cell, or `NO_STOP`.
        ways: Receives them, those to stop i at entry `base` + i.
        base: Where the entries of this cell begin.
        rounds: Working memory.
    """
    fewest, action_of, reached_in = rounds.fewest, rounds.action, rounds.reached_in
    moves: Any = tables.moves
    drain: Any = tables.drain
    last: Any = rounds.last
    reached: Any = rounds.next
    for cell in range(tables.cells):
        fewest[cell] = UNREACHED
        reached_in[cell] = 0
        if stop_at[cell] != NO_STOP:
            ways.count[base + stop_at[cell]] = 0
    fewest[start] = 0
    last[0, 0], last[1, 0], last[2, 0] = start, 0, 0
    n_last, steps = 1, 0
    while n_last > 0:
        steps += 1
        n_reached = 0
        for k in range(n_last):
            cell = last[0, k]
            if ground[cell] == DELIVERY_CELL and cell != start:
                continue
            for action in range(N_MOVES):
                to = moves[cell * N_ACTIONS + action]
                if collision(tables, ground, to) != NONE:
                    continue
                units = last[1, k] + counts * drain[ground[to] * N_ACTIONS + action]
                if units >= fewest[to] or (units >= most and ground[to] != DELIVERY_CELL):
                    continue
                if reached_in[to] != steps:
                    reached_in[to] = steps
                    reached[0, n_reached] = to
                    n_reached += 1
                fewest[to] = units
                action_of[to] = action if steps == 1 else last[2, k]
        for k in range(n_reached):
            cell = reached[0, k]
            reached[1, k] = fewest[cell]
            reached[2, k] = action_of[cell]
            if stop_at[cell] != NO_STOP:
                stop = base + stop_at[cell]
                n = ways.count[stop]
                ways.units[stop, n] = fewest[cell]
                ways.steps[stop, n] = steps
                ways.first[stop, n] = action_of[cell]
                ways.count[stop] = n + 1
        last, reached = reached, last
        n_last = n_reached


register_jitable(**compiled.OPTIONS)(find_ways)
