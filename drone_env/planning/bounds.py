"""Proven bounds of the optimum, for maps that are too large for the exact solvers."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from drone_env.core.actions import N_ACTIONS
from drone_env.core.cells import N_CELL_KINDS, Cell
from drone_env.core.compile_cache import compiled_once
from drone_env.core.episode import Episode, rollout
from drone_env.core.rules import score_of
from drone_env.core.tables import N_MOVES, Tables, tabulate
from drone_env.planning.greedy import greedy_action
from drone_env.planning.paths import costs_from
from drone_env.planning.states import drain_range, state_arrays
from drone_env.planning.tours import UNREACHED, held_karp

tour_kernel = compiled_once(nogil=True)(held_karp)


class Bounds(NamedTuple):
    """Inclusive bounds of the best score that can still be reached."""

    lower: float
    """The score of a flight that was flown."""
    upper: float
    """A score that no flight exceeds."""


def bounds(episode: Episode) -> Bounds:
    """Bounds of the optimum from the current state of an episode, which is not changed.

    Lower bound: the score of a flight that always flies to the nearest target. Upper bound: the score with all parcels
    that the shortest tour reaches in the steps left, and with the battery that the cheapest tour leaves. Charging takes
    steps.
    """
    flown = rollout(episode.copy(), partial(greedy_action, episode.task)).score
    return Bounds(flown, max(_upper(episode), flown))


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
    visited = tour_kernel(first[parcels], legs[:, parcels], n, budget, lengths, order)
    return int(visited), int(lengths[-1].min())
