"""Proven bounds of the optimum, for maps that are too large for the exact solvers."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable  # pyright: ignore

from drone_env.core.actions import N_ACTIONS, Action
from drone_env.core.cells import N_CELL_KINDS, Cell
from drone_env.core.compile_cache import compiled_once
from drone_env.core.episode import Episode, rollout
from drone_env.core.rules import score_of
from drone_env.core.tables import N_MOVES, Tables, tabulate
from drone_env.errors import TooLargeError
from drone_env.planning.from_observation import episode_from_fields
from drone_env.planning.greedy import greedy_action
from drone_env.planning.legs import LegSolver, covers
from drone_env.planning.paths import NO_PATH, costs_from
from drone_env.planning.states import drain_range, state_arrays
from drone_env.planning.tours import UNREACHED, held_karp

register_jitable(held_karp)
AHEAD = 4
"""Number of nearest parcels in each plan of the lower bound."""


class Bounds(NamedTuple):
    """Inclusive bounds of the best score that can still be reached."""

    lower: float
    """The score of a flight that was flown."""
    upper: float
    """A score that no flight exceeds."""


def bounds(episode: Episode) -> Bounds:
    """Bounds of the optimum from the current state of an episode, which is not changed.

    Lower bound: the better of two flights. One always flies to the nearest target; the other plans a best flight over
    the `AHEAD` nearest parcels, again after each delivery. Upper bound: the score with all parcels that the shortest
    tour reaches in the steps left, and with the battery that the cheapest tour leaves. Charging takes steps.
    """
    flown = rollout(episode.copy(), partial(greedy_action, episode.task)).score
    if not episode.ended and covers(episode.task):
        flown = max(flown, _by_parts(episode).score)
    return Bounds(flown, max(_upper(episode), flown))


def _by_parts(episode: Episode) -> Episode:
    """Fly a copy by best flights over its nearest parcels. It waits if even one parcel is too large a plan."""
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
    steps = costs_from(tabulate(flight.task), ground, flight.cell, np.ones(N_CELL_KINDS))
    waiting = sorted((cell for cell in state[entries].tolist() if steps[cell] < NO_PATH), key=steps.__getitem__)
    ground[state[entries]] = Cell.DELIVERED
    for n in range(min(AHEAD, len(waiting)), 0, -1):
        near = waiting[:n]
        # A task of these parcels only; its maps are never generated.
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
    task, tables = episode.task, tabulate(episode.task)
    ground, state, entries = state_arrays(episode)
    steps_left, done = task.max_steps - episode.steps, episode.deliveries_done
    pads = np.flatnonzero(ground == Cell.PAD).tolist() if task.charge_rate else []
    least_drain, _ = drain_range(task)

    def score(deliveries: int, battery: int, after: int) -> float:
        return score_of(tables, deliveries, min(max(battery, 0), tables.capacity), episode.steps + after)

    ones = np.ones(N_CELL_KINDS)
    first = costs_from(tables, ground, episode.cell, ones)
    near: list[int] = [cell for cell in state[entries].tolist() if first[cell] <= steps_left]
    reached, steps = _tour(tables, ground, episode.cell, near, ones, steps_left) if near else (0, 0)
    after_one = tables.capacity if pads else episode.battery_units - least_drain
    if done + reached < task.deliveries:
        return score(done + reached, after_one, 1)
    drains = _least_drains(tables)
    _, drained = _tour(tables, ground, episode.cell, near, drains, UNREACHED - 1)
    from_pad = int(costs_from(tables, ground, pads, drains)[near].min())
    most = [tables.capacity] + [tables.capacity - from_pad] * (steps_left - steps)
    # The step to the last parcel may need more than the battery has.
    spare = max(drains[Cell.DELIVERY] - 1, 0)
    ends = [score(task.deliveries - 1, after_one, 1)]  # only relevant without `efficiency_needs_all`
    for waits in range(len(most) if pads else 1):
        left = episode.battery_units - drained + task.charge_rate * waits
        if left + spare >= 0:
            ends.append(score(task.deliveries, min(left, most[waits]), steps + waits))
    return max(ends)


def _least_drains(tables: Tables) -> list[int]:
    """The lowest drain of a move onto each kind of cell. The drone also flies over delivered parcels."""
    onto = np.reshape(tables.drain, (N_CELL_KINDS, N_ACTIONS))[:, :N_MOVES]
    drains: list[int] = onto.min(axis=1).tolist()
    drains[Cell.DELIVERY] = min(drains[Cell.DELIVERY], drains[Cell.DELIVERED])
    return drains


def _tour(
    tables: Tables, ground: Any, start: int, parcels: Sequence[int], kind_costs: Any, budget: int
) -> tuple[int, int]:
    """The number of parcels within a budget, and the cost of the cheapest tour over all of them (or `UNREACHED`)."""
    n, first = len(parcels), costs_from(tables, ground, start, kind_costs)
    legs = np.array([costs_from(tables, ground, parcel, kind_costs) for parcel in parcels])
    lengths, order = np.zeros((1 << n, n), np.int64), np.zeros(n, np.int64)
    visited = tour_kernel(first[parcels], legs[:, parcels], budget, lengths, order)
    return int(visited), int(lengths[-1].min())


@compiled_once(nogil=True)
def tour_kernel(first: Any, legs: Any, budget: int, lengths: Any, order: Any) -> int:
    """`held_karp`, compiled."""
    return held_karp(first, legs, len(first), budget, lengths, order)
