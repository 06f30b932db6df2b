"""Exact values by legs: dynamic programming over (set delivered, stop, battery, steps).

A flight is an order of stops at parcels and pads, and a path between consecutive stops. Only Pareto-optimal paths can
be part of a best flight. A leg ends at a waiting parcel, because the drone delivers it there. So the solver stores the
values of stops; the value of any other cell follows from the paths that start there. (Bellman, "Dynamic Programming",
1957; Held and Karp 1962 for the sets.)

It covers uniform tasks, and tasks in which incomplete flights score their parcels only (`efficiency_needs_all`). As in
`solver`, a value is stored as the rank of a score among all scores of the task.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import FLYING, N_ACTIONS, WAIT, Action
from drone_env.core.cells import DELIVERED_CELL, DELIVERY_CELL, PAD_CELL
from drone_env.core.compile_cache import compiled_once
from drone_env.core.compiled import OPTIONS, jitable, kernel
from drone_env.core.episode import Episode
from drone_env.core.rewards import Rewards, tabulate_rewards
from drone_env.core.rules import step, units_left
from drone_env.core.tables import BATTERY, CELL, OUTCOME
from drone_env.core.tasks import TaskConfig
from drone_env.errors import TooLargeError, UnsupportedTaskError
from drone_env.planning.paths import PathSearch, find_paths, least_units, make_search
from drone_env.planning.solver import Solver, ranked_scores
from drone_env.planning.states import UNPAID, delivered_set, require_memory, state_arrays

MAX_BETWEEN_PADS = 32 << 30
"""Limit of (sets delivered) * pads * stops * (battery units) * steps. A billion takes at most a second."""
ROWS_AT_ONCE = 64
"""States per call. Other threads run between two chunks."""


def covers(task: TaskConfig) -> bool:
    """Whether `LegSolver` covers a task."""
    return task.uniform or task.efficiency_needs_all


class Legs(NamedTuple):
    """One map and its values, for kernels. Stops are the parcels that wait in the solved state, then the pads."""

    search: PathSearch
    """The map, with entries for the paths from a parcel and from each pad to every stop. Kernels modify its ground."""
    stops: Any
    """int64[N], the cell of each stop."""
    parcels: Any
    """Number of stops that are parcels, n."""
    most: Any
    """Maximum number of units."""
    ranks: Any
    """[rows, steps + 1], the rank of the highest score that can still be reached, by steps left. First come the ends:
    one row for each number of delivered parcels and units (`end_row`). Then one row for each parcel, set delivered that
    contains it, and units, and one for each set delivered, pad and units (`row_of`). The rows of the complete set and
    of 0 units are unused."""


@jitable
def end_row(legs: Legs, done: int, units: int) -> int:
    """The row of ends with `done` delivered parcels."""
    return done * (legs.most + 1) + units


@jitable
def row_of(legs: Legs, delivered: int, stop: int, units: int) -> int:
    """The row of a drone at a pad, or at a parcel of the set delivered."""
    n = legs.parcels
    if stop < n:
        others = delivered >> (stop + 1) << stop | delivered & (1 << stop) - 1
        place = (stop << n - 1) + others
    else:
        place = (n << n - 1) + delivered * (len(legs.stops) - n) + stop - n
    return (n + 1 + place) * (legs.most + 1) + units


@jitable
def mark_delivered(legs: Legs, delivered: int) -> int:
    """Write the delivered parcels onto the ground, and return their number."""
    done = 0
    for i in range(legs.parcels):
        bit = delivered >> i & 1
        done += bit
        legs.search.ground[legs.stops[i]] = DELIVERED_CELL if bit else DELIVERY_CELL
    return done


@jitable
def arrives(legs: Legs, stop: int, units: int) -> bool:
    """Whether a drone can reach a stop with these units left."""
    return units >= least_units(legs.search.tables, stop < legs.parcels)


@jitable
def row_after(legs: Legs, delivered: int, done: int, stop: int, units: int) -> int:
    """The row of a drone after it arrives at a stop with these units left."""
    if stop >= legs.parcels:
        return row_of(legs, delivered, stop, units)
    units = max(units, 0)
    if done + 1 == legs.parcels or units == 0:
        return end_row(legs, done + 1, units)
    return row_of(legs, delivered | 1 << stop, stop, units)


@jitable
def raise_row(ranks: Any, row: int, after: int, steps: int) -> None:
    """Raise the values of a row to those of another row, `steps` steps later."""
    if steps >= ranks.shape[1]:
        return
    # Slices make this loop five times faster: the compiler does not vectorise indices that may be negative.
    later = ranks[row, steps:]
    reached = ranks[after, : len(later)]
    for left in range(len(later)):
        later[left] = max(later[left], reached[left])


@jitable
def raise_by_paths(
    legs: Legs,
    delivered: int,
    done: int,
    base: int,
    units: int,
    row: int,
    first: int,
    stop_end: int,
) -> None:
    """Raise the row of a drone with these units by the paths to the stops in [first, stop_end)."""
    paths = legs.search.paths
    for stop in range(first, stop_end):
        if stop < legs.parcels and delivered >> stop & 1:
            continue
        for k in range(paths.count[base + stop]):
            left = units - paths.units[base + stop, k]
            if arrives(legs, stop, left):
                after = row_after(legs, delivered, done, stop, left)
                raise_row(legs.ranks, row, after, paths.steps[base + stop, k])


@jitable
def begin_row(legs: Legs, done: int, units: int, row: int) -> None:
    """Set a row to the values of a flight that makes no further delivery."""
    end = end_row(legs, done, units)
    for left in range(legs.ranks.shape[1]):
        legs.ranks[row, left] = legs.ranks[end, left]


@jitable
def sum_at_pads(legs: Legs, delivered: int) -> int:
    """The sum of all ranks at pads. It changes if any of them is raised."""
    first, end = row_of(legs, delivered, legs.parcels, 0), row_of(legs, delivered, len(legs.stops), 0)
    total = 0
    for row in range(first, end):
        for rank in legs.ranks[row]:
            total += rank
    return total


@kernel
def value_kernel(legs: Legs) -> None:
    """Compute the ranks."""
    n, stops = legs.parcels, len(legs.stops)
    charge = -legs.search.tables.drain[PAD_CELL * N_ACTIONS + WAIT]
    for delivered in range((1 << n) - 2, -1, -1):
        done = mark_delivered(legs, delivered)
        for pad in range(n, stops):
            base = (pad - n + 1) * stops
            find_paths(legs.search, legs.stops[pad], legs.most, base)
            for units in range(1, legs.most + 1):
                row = row_of(legs, delivered, pad, units)
                begin_row(legs, done, units, row)
                raise_by_paths(legs, delivered, done, base, units, row, 0, n)
        before, total = -1, sum_at_pads(legs, delivered)
        while before != total:
            for pad in range(n, stops):
                base = (pad - n + 1) * stops
                for units in range(legs.most, 0, -1):
                    row = row_of(legs, delivered, pad, units)
                    charged = units_left(legs.search.tables, units, -charge)
                    if charged > units:
                        raise_row(legs.ranks, row, row_of(legs, delivered, pad, charged), 1)
                    raise_by_paths(legs, delivered, done, base, units, row, n, stops)
            before, total = total, sum_at_pads(legs, delivered)
        for parcel in range(n):
            if delivered >> parcel & 1:
                find_paths(legs.search, legs.stops[parcel], legs.most, 0)
                for units in range(1, legs.most + 1):
                    row = row_of(legs, delivered, parcel, units)
                    begin_row(legs, done, units, row)
                    raise_by_paths(legs, delivered, done, 0, units, row, 0, stops)


@jitable
def best_option(legs: Legs, delivered: int, cell: int, units: int, steps: int) -> tuple[Any, int]:
    """The rank of the highest score that a drone can still reach from a cell, and an action towards it.

    The action is -1 if no further delivery raises the score. Ties go to the first option, in the order of stops and of
    their paths; charging comes last.
    """
    done, paths, tables = mark_delivered(legs, delivered), legs.search.paths, legs.search.tables
    find_paths(legs.search, cell, units, 0)
    best, action = legs.ranks[end_row(legs, done, units), steps], -1
    for stop in range(len(legs.stops)):
        if stop < legs.parcels and delivered >> stop & 1:
            continue
        for k in range(paths.count[stop]):
            left = steps - paths.steps[stop, k]
            if left < 0:
                break
            rank = legs.ranks[row_after(legs, delivered, done, stop, units - paths.units[stop, k]), left]
            if rank > best:
                best, action = rank, paths.first[stop, k]
    at = legs.search.stop_at[cell]
    if at >= legs.parcels and steps > 0:
        charged = units_left(tables, units, int(tables.drain[PAD_CELL * N_ACTIONS + WAIT]))
        rank = legs.ranks[row_of(legs, delivered, at, charged), steps - 1]
        if rank > best:
            best, action = rank, WAIT
    return best, action


# These two hold the interpreter's lock, because threads that use the same solver share its working memory.
@compiled_once(**OPTIONS)
def rank_kernel(legs: Legs, states: Any, ranks: Any) -> None:
    """Write the rank of the highest score that can still be reached from each state.

    Args:
        legs: The map with its ranks.
        states: int64[N, 4]: set delivered, cell, units and steps left, as returned by `clock`.
        ranks: int64[N], receives the ranks.
    """
    for k in range(len(states)):
        delivered, cell, units, steps = states[k]
        ranks[k], _ = best_option(legs, delivered, cell, units, steps)


@compiled_once(**OPTIONS)
def flight_kernel(legs: Legs, rewards: Rewards, grid: Any, state: Any, parcels: Any, actions: Any) -> int:
    """Fly the shortest best flight by the rules, write its actions, and return their number.

    Args:
        legs: The map with its ranks.
        rewards: Tables of any profile; not used.
        grid: uint8[cells], with the drone; modified.
        state: uint16[state size] of the solved episode; modified.
        parcels: int64[n], the entries of `state` of the waiting parcels.
        actions: int64[steps], receives the actions.
    """
    steps, flown = len(actions), 0
    units = state[BATTERY] if legs.search.counts else 1
    best, _ = best_option(legs, 0, state[CELL], units, steps)
    while steps > 0 and best_option(legs, 0, state[CELL], units, steps - 1)[0] == best:
        steps -= 1
    while state[OUTCOME] == FLYING and flown < steps:
        delivered = delivered_set(state, parcels)
        units = state[BATTERY] if legs.search.counts else 1
        _, action = best_option(legs, delivered, state[CELL], units, steps - flown)
        if action < 0:
            break
        actions[flown] = action
        flown += 1
        step(legs.search.tables, rewards, grid, state, action)
    return flown


def clock(task: TaskConfig, battery: Any, left: Any) -> tuple[Any, Any]:
    """Convert battery units and steps left, numbers or arrays, to units and steps left of the kernels."""
    return (battery, left) if not task.uniform else (1, np.minimum(battery, left))


def require_room(task: TaskConfig, parcels: int, pads: int, units: int, steps: int) -> int:
    """The number of rows of ranks for a map.

    Raises:
        TooLargeError: if the rows would take more memory than `states.MAX_BYTES`, or the paths between pads more
            comparisons than `MAX_BETWEEN_PADS`.
    """
    rows = (parcels + 1 + (parcels << parcels - 1) + (pads << parcels)) * (units + 1)
    require_memory("the exact values", task, 2 * rows * (steps + 1))
    between_pads = pads * (parcels + pads) * units * steps << parcels
    if between_pads > MAX_BETWEEN_PADS:
        raise TooLargeError(
            f"solving a map of {task.id!r} with {pads} pads takes {between_pads / 1e9:.0f} billion comparisons; "
            f"{MAX_BETWEEN_PADS / 1e9:.0f} billion are allowed"
        )
    _, ranked = ranked_scores(task)
    require_memory("the exact values", task, ranked.itemsize * rows * (steps + 1))
    return rows


def make_legs(
    task: TaskConfig, ground: npt.NDArray[np.uint8], parcels: Sequence[int], done: int, battery: int, left: int
) -> Legs:
    """Allocate a map from a state in flight on; `value_kernel` computes its ranks.

    Args:
        task: The task.
        ground: uint8[cells], the kind of each cell without the drone.
        parcels: The cells of the waiting parcels.
        done: The number of delivered parcels.
        battery: Units left.
        left: Steps left.

    Raises:
        UnsupportedTaskError: if `covers(task)` is False.
        TooLargeError: as `require_room` and `make_search`.
    """
    if not covers(task):
        raise UnsupportedTaskError(
            f"task {task.id!r}: LegSolver needs equal costs of all steps, or efficiency_needs_all"
        )
    counts, n = not task.uniform, len(parcels)
    pads = np.flatnonzero(ground == PAD_CELL) if counts and task.charge_rate else np.zeros(0, np.int64)
    stops = np.concatenate([np.array(parcels, np.int64), pads])
    units, steps = (task.battery_capacity, left) if counts else clock(task, battery, left)
    rows = require_room(task, n, len(pads), units, steps)
    search = make_search(task, len(stops) * (len(pads) + 1))
    search.ground[:] = ground
    search.stop_at[stops] = np.arange(len(stops))
    _, ranked = ranked_scores(task)
    ranks = np.zeros((rows, steps + 1), ranked.dtype)
    ends = np.reshape(ranks[: (n + 1) * (units + 1)], (n + 1, units + 1, steps + 1))
    later = np.arange(steps + 1)
    if counts:
        ends[:n] = ranked[done : done + n, 0, task.max_steps][:, None, None]
        ends[n] = ranked[task.deliveries][:, task.max_steps - later]
    else:
        # The difference between battery and steps left is constant.
        ends[:n] = ranked[done : done + n, battery - steps, task.max_steps - left + steps][:, None, None]
        ends[n] = ranked[task.deliveries, battery - steps + later, task.max_steps - left + steps - later]
    return Legs(search, stops, n, units, ranks)


class LegSolver(Solver):
    """Values of every state, computed from those at parcels and pads.

    Attributes:
        legs: The map with its ranks.
        scores: float64, the score of each rank.

    Args:
        episode: An episode in flight; it is not changed.

    Raises:
        EpisodeError: if the episode has not started, or has ended.
        UnsupportedTaskError: if `covers(task)` is False.
        TooLargeError: as `make_legs`.
    """

    def __init__(self, episode: Episode) -> None:
        super().__init__(episode)
        task = episode.task
        ground, state, entries = state_arrays(episode)
        parcels, left = state[entries].tolist(), task.max_steps - episode.steps
        self.legs = make_legs(task, ground, parcels, episode.deliveries_done, episode.battery_units, left)
        self.scores, _ = ranked_scores(task)
        value_kernel(self.legs)

    def _values_in_flight(self, states: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
        delivered, cells, battery, left = states.T
        units, steps = clock(self._start.task, battery, left)
        rows = np.stack(np.broadcast_arrays(delivered, cells, units, steps), axis=1)
        rows, which = np.unique(rows, axis=0, return_inverse=True)  # several actions lead to the same cell
        ranks = np.zeros(len(rows), np.int64)
        for i in range(0, len(rows), ROWS_AT_ONCE):
            rank_kernel(self.legs, rows[i : i + ROWS_AT_ONCE], ranks[i : i + ROWS_AT_ONCE])
        return self.scores[ranks[which.ravel()]]

    def best_actions(self) -> list[Action]:
        """One best sequence of actions from the solved state; the same in every run.

        If the episode has not ended then, only waiting remains.
        """
        start, task = self._start, self._start.task
        _, state, parcels = state_arrays(start)
        _, steps = clock(task, start.battery_units, task.max_steps - start.steps)
        actions = np.zeros(steps, np.int64)
        rewards, grid = tabulate_rewards(task, UNPAID), start.grid().ravel()
        flown = flight_kernel(self.legs, rewards, grid, state, parcels, actions)
        return [Action(action) for action in actions[:flown].tolist()]
