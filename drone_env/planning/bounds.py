"""Proven bounds of the optimum, for maps that are too large to be solved exactly."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from heapq import heappop, heappush
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core.actions import N_ACTIONS, Action, Event
from drone_env.core.cells import N_CELL_KINDS, Cell
from drone_env.core.compile_cache import compiled_once
from drone_env.core.episode import Episode, rollout
from drone_env.core.rules import collision, score_of
from drone_env.core.tables import N_MOVES, Tables, interpreted, view
from drone_env.errors import TooLargeError
from drone_env.planning.from_observation import episode_from_fields
from drone_env.planning.greedy import greedy_action
from drone_env.planning.legs import LegSolver, covers
from drone_env.planning.states import drain_range, state_arrays
from drone_env.planning.tours import UNREACHED, held_karp

register_jitable(held_karp)
AHEAD = 4
"""The best flight is planned over this many of the nearest parcels, again after each delivery."""


class Bounds(NamedTuple):
    """Bounds of the best score that can still be reached, both included."""

    lower: float
    """The score of a flight that was flown."""
    upper: float
    """A score that no flight exceeds."""


def bounds(episode: Episode) -> Bounds:
    """Bounds of the optimum from where an episode stands; the episode is left as it is.

    Below: the better of two flights, flown to their ends: to the nearest target, and by best flights over the `AHEAD`
    nearest parcels, planned anew at each delivery. Above: the score with all the parcels that the steps left allow on
    the shortest tour, and with what the cheapest tour leaves of the battery, for which to charge takes its steps.
    """
    flown = rollout(episode.copy(), partial(greedy_action, episode.task)).score
    if not episode.ended and covers(episode.task):
        flown = max(flown, _by_parts(episode).score)
    return Bounds(flown, max(_upper(episode), flown))


def _by_parts(episode: Episode) -> Episode:
    """Fly a copy by best flights over its nearest parcels; it ends early where there is no room to plan even one."""
    flight = episode.copy()
    while not flight.ended:
        before = flight.deliveries_done
        for action in _plan_part(flight):
            flight.step(action)
            if flight.ended or flight.deliveries_done > before:
                break
        if flight.deliveries_done == before:
            break
    return flight.waited_out()


def _plan_part(flight: Episode) -> list[Action]:
    ground, state, entries = state_arrays(flight)
    tables = interpreted(flight.task)
    steps = _costs_from(tables, ground, [flight.cell], [1] * N_CELL_KINDS)
    waiting = sorted((cell for cell in state[entries].tolist() if steps[cell] < UNREACHED), key=steps.__getitem__)
    ground[state[entries]] = Cell.DELIVERED
    for n in range(min(AHEAD, len(waiting)), 0, -1):
        near = waiting[:n]
        # A task of this part alone: no map of it is generated.
        bare = {"terrain": None, "buildings": 0, "trees": 0, "obstacles": 0, "street_spacing": 0}
        task = replace(flight.task, deliveries=n, **bare)
        ground[near] = Cell.DELIVERY
        parcels = [(cell, False) for cell in near]
        part = episode_from_fields(task, ground, flight.cell, flight.battery_units, flight.steps, parcels)
        try:
            return LegSolver(part).best_actions()
        except TooLargeError:
            ground[near] = Cell.DELIVERED
    return []


def _upper(episode: Episode) -> float:
    if episode.ended:
        return episode.score
    task, tables = episode.task, interpreted(episode.task)
    ground, state, entries = state_arrays(episode)
    steps_left, done = task.max_steps - episode.steps, episode.deliveries_done
    pads = np.flatnonzero(ground == Cell.PAD).tolist() if task.charge_rate else []
    least_drain, _ = drain_range(task)

    def score(deliveries: int, battery: int, after: int) -> float:
        return score_of(tables, deliveries, min(max(battery, 0), tables.capacity), episode.steps + after)

    ones = [1] * N_CELL_KINDS
    first = _costs_from(tables, ground, [episode.cell], ones)
    near: list[int] = [cell for cell in state[entries].tolist() if first[cell] <= steps_left]
    reached, steps = _tour(tables, ground, episode.cell, near, ones, steps_left) if near else (0, 0)
    after_one = tables.capacity if pads else episode.battery_units - least_drain
    if done + reached < task.deliveries:
        return score(done + reached, after_one, 1)
    drains = _least_drains(tables)
    _, drained = _tour(tables, ground, episode.cell, near, drains, UNREACHED - 1)
    from_pad = _costs_from(tables, ground, pads, drains)
    most = [tables.capacity] + [tables.capacity - min(from_pad[cell] for cell in near)] * (steps_left - steps)
    # The step to the last parcel may ask for more than is left.
    spare = max(drains[Cell.DELIVERY] - 1, 0)
    ends = [score(task.deliveries - 1, after_one, 1)]  # can only pay where efficiency counts without all
    for waits in range(len(most) if pads else 1):
        left = episode.battery_units - drained + task.charge_rate * waits
        if left + spare >= 0:
            ends.append(score(task.deliveries, min(left, most[waits]), steps + waits))
    return max(ends)


def _least_drains(tables: Tables) -> list[int]:
    """The least that a move onto each kind of cell drains; a parcel's cell is also flown over once it is delivered."""
    onto = np.reshape(tables.drain, (N_CELL_KINDS, N_ACTIONS))[:, :N_MOVES]
    drains: list[int] = onto.min(axis=1).tolist()
    drains[Cell.DELIVERY] = min(drains[Cell.DELIVERY], drains[Cell.DELIVERED])
    return drains


def _tour(
    tables: Tables, ground: Any, start: int, parcels: Sequence[int], costs: Sequence[int], budget: int
) -> tuple[int, int]:
    """How many of the parcels a budget allows to visit, and the cost of the cheapest tour over all (or `UNREACHED`)."""
    n, first = len(parcels), np.array(_costs_from(tables, ground, [start], costs))
    legs = np.array([_costs_from(tables, ground, [parcel], costs) for parcel in parcels])
    lengths, order = np.zeros((1 << n, n), np.int64), np.zeros(n, np.int64)
    visited = tour_kernel(first[parcels], legs[:, parcels], budget, lengths, order)
    return int(visited), int(lengths[-1].min())


@compiled_once(nogil=True)
def tour_kernel(first: Any, legs: Any, budget: int, lengths: Any, order: Any) -> int:
    """`held_karp`, compiled."""
    return held_karp(first, legs, len(first), budget, lengths, order)


def _costs_from(tables: Tables, ground: Any, starts: Sequence[int], costs: Sequence[int]) -> list[int]:
    """The cost of the cheapest path to each cell, `UNREACHED` without one.

    Dijkstra, "A note on two problems in connexion with graphs", 1959.

    Args:
        tables: The task's tables.
        ground: uint8[cells], without the drone.
        starts: Cells where paths may begin.
        costs: The cost of a move onto each kind of cell.
    """
    grid = view(ground)
    found = [UNREACHED] * tables.cells
    queue = [(0, cell) for cell in starts]
    for cell in starts:
        found[cell] = 0
    while queue:
        cost, cell = heappop(queue)
        if cost > found[cell]:
            continue
        for action in range(N_MOVES):
            to = int(tables.moves[cell * N_ACTIONS + action])
            if collision(tables, grid, to) == Event.NONE and cost + costs[grid[to]] < found[to]:
                found[to] = cost + costs[grid[to]]
                heappush(queue, (found[to], to))
    return found
