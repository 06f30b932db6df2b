"""The exact optimum of a map, by the fastest planner that covers its task.

- Where every step costs one battery unit and nothing blocks the way, the score grows with each parcel, and with all
  parcels delivered it falls with each step; an episode that does not deliver all lasts until the battery or the steps
  run out, so then only the number of parcels counts. The best flight is therefore the shortest path over all parcels
  if it fits into the budget of steps, else any path over as many parcels as fit: `shortest_tour`.
- Everywhere else: the solver of `solvers`, which knows the value of every other state as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from drone_env.core.actions import Action, Event
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import TooLargeError
from drone_env.planning.held_karp import UNREACHED, held_karp
from drone_env.planning.paths import Position, distance, route

if TYPE_CHECKING:
    from drone_env.planning.solver import Solver


@dataclass(frozen=True)
class Solution:
    """The best that can be made of an episode, flown to its end by the rules.

    Attributes:
        score: The highest score that can be reached.
        success: Whether all parcels can be delivered.
        steps: Steps from here to the end of the episode.
        deliveries: Parcels delivered at the end.
        order: (x, y) of the parcels that it delivers, in their order.
        actions: One best sequence of actions from here to the end.
    """

    score: float
    success: bool
    steps: int
    deliveries: int
    order: tuple[Position, ...]
    actions: tuple[Action, ...]


def solve(task: str | TaskConfig, seed: int) -> Solution:
    """The optimum of a map.

    Raises:
        UnknownNameError: if there is no such task.
        InvalidValueError: if the seed is not in [0, 2^53).
        TooLargeError: if the solution would take too much memory; `bounds` knows then what it lies between.
    """
    return solve_episode(Episode(task, seed=seed))


def best_of(task: TaskConfig, seed: int) -> Solution | None:
    """The optimum of a map, None where it is too large to be solved."""
    try:
        return solve(task, seed)
    except TooLargeError:
        return None


def require_solvable(task: TaskConfig) -> None:
    """See that maps of a task are not too large to be solved, before any is.

    Raises:
        TooLargeError: if they are.
    """
    if not task.uniform and task.efficiency_needs_all:
        from drone_env.planning.legs import require_room  # it compiles

        require_room(task, task.deliveries, task.pads if task.charge_rate else 0, task.battery_capacity, task.max_steps)


def solve_episode(episode: Episode, solver: "Solver | None" = None) -> Solution:
    """The optimum from where an episode stands; the episode is left as it is.

    Args:
        episode: The episode.
        solver: Of just this episode, where there is one; None to make one if need be.

    Raises:
        TooLargeError: if the solution would take too much memory.
    """
    flight = episode.copy().fly(best_actions(episode, solver)).waited_out()
    path = flight.path[len(episode.actions) :]
    order = tuple((point.x, point.y) for point in path if point.event is Event.DELIVERY)
    actions = tuple(point.action for point in path)
    return Solution(flight.score, flight.success, len(actions), flight.deliveries_done, order, actions)


def best_actions(episode: Episode, solver: "Solver | None" = None) -> list[Action]:
    """The actions of a best flight from where an episode stands; at their end there may be nothing left but to wait.

    Args:
        episode: The episode.
        solver: As of `solve_episode`.

    Raises:
        TooLargeError: if the solution would take too much memory.
    """
    if episode.ended:
        return []
    if episode.task.uniform:
        waiting = [(x, y) for x, y, delivered in episode.parcels if not delivered]
        budget = min(episode.battery_units, episode.task.max_steps - episode.steps)
        return tour_actions(episode.position, shortest_tour(episode.position, waiting, budget))
    if solver is None:
        # It compiles, which nobody should wait for who does not need it.
        from drone_env.planning.solvers import solver_of

        solver = solver_of(episode)
    return solver.best_actions()


def tour_actions(start: Position, tour: Sequence[Position]) -> list[Action]:
    """The actions that visit the positions of a tour one after another."""
    stops = [start, *tour]
    return [action for a, b in pairwise(stops) for action in route(a, b)]


def shortest_tour(start: Position, parcels: Sequence[Position], budget: int) -> list[Position]:
    """The parcels in the order that visits as many as `budget` steps allow, in as few steps as that takes."""
    n = len(parcels)
    first = [distance(start, parcel) for parcel in parcels]
    legs = [[distance(a, b) for b in parcels] for a in parcels]
    lengths = [[UNREACHED] * n for _ in range(1 << n)]
    order = [0] * n
    visited = held_karp(first, legs, n, budget, lengths, order)
    return [parcels[i] for i in order[:visited]]
