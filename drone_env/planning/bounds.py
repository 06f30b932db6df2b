"""Proven bounds of the optimum, for maps that are too large to be solved exactly."""

from collections import deque
from functools import partial
from typing import NamedTuple

from drone_env.core.actions import N_ACTIONS, Action, Event
from drone_env.core.episode import Episode
from drone_env.core.obstacles import collision
from drone_env.core.rollout import rollout
from drone_env.core.score import score_of
from drone_env.core.tables import Buffer, Tables, interpreted, view
from drone_env.planning.greedy import greedy_action
from drone_env.planning.held_karp import UNREACHED, held_karp
from drone_env.planning.map_graph import drain_range

MAX_TOURED = 10
"""Parcels up to which the shortest tour over them is worked out; above it, only how far the farthest is."""


class Bounds(NamedTuple):
    """What the best score that can still be reached lies between, both ends included."""

    lower: float
    """The score of a flight that was flown."""
    upper: float
    """A score that no flight exceeds."""


def bounds(episode: Episode) -> Bounds:
    """Bounds of the optimum from where an episode stands; the episode is left as it is.

    Below: the nearest-target flight, flown to its end. Above: the score if the battery lasted forever and ended full
    (or, where nothing charges, had lost only the cheapest steps), with all the parcels that the steps left allow on
    the shortest tour.
    """
    flight = rollout(episode.copy(), partial(greedy_action, episode.task))
    return Bounds(flight.score, max(_upper(episode), flight.score))


def _upper(episode: Episode) -> float:
    task, tables = episode.task, interpreted(episode.task)
    if episode.ended:
        return episode.score
    waiting = [y * task.width + x for x, y, delivered in episode.parcels if not delivered]
    steps_left = task.max_steps - episode.steps
    grid = view(episode.grid().ravel())
    first = _steps_to(tables, grid, episode.cell)
    near = [cell for cell in waiting if first[cell] <= steps_left]
    reached, steps = len(near), max((first[cell] for cell in near), default=0)
    if 0 < len(near) <= MAX_TOURED:
        legs = [[from_here[b] for b in near] for from_here in (_steps_to(tables, grid, a) for a in near)]
        n = len(near)
        lengths, order = [[UNREACHED] * n for _ in range(1 << n)], [0] * n
        reached = held_karp([first[cell] for cell in near], legs, n, steps_left, lengths, order)
        steps = min(lengths[(1 << n) - 1]) if reached == n else steps_left
    charges = bool(task.pads and task.charge_rate)
    least_drain, _ = drain_range(task)

    def score(deliveries: int, after: int) -> float:
        battery = tables.capacity if charges else max(episode.battery_units - least_drain * after, 0)
        return score_of(tables, deliveries, battery, episode.steps + after)

    done = episode.deliveries_done
    if done + reached == task.deliveries:
        # Ending earlier with a parcel less can only pay where efficiency counts without it.
        return max(score(task.deliveries, steps), score(task.deliveries - 1, 1))
    return score(done + reached, 1)


def _steps_to(tables: Tables, grid: Buffer, start: int) -> list[int]:
    """The fewest steps from a cell to each other, `UNREACHED` where nothing leads."""
    steps = [UNREACHED] * tables.cells
    steps[start] = 0
    queue = deque([start])
    while queue:
        cell = queue.popleft()
        for action in range(Action.WAIT):
            to = tables.moves[cell * N_ACTIONS + action]
            if collision(tables, grid, to) == Event.NONE and steps[to] == UNREACHED:
                steps[to] = steps[cell] + 1
                queue.append(to)
    return steps
