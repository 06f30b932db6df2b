"""The exact optimum of a map, by the fastest planner that covers its task.

- Where every step costs one battery unit and nothing blocks the way, the score grows with each parcel, and with all
  parcels delivered it falls with each step; an episode that does not deliver all lasts until the battery or the steps
  run out, so then only the number of parcels counts. The best flight is therefore the shortest path over all parcels
  if it fits into the budget of steps, else any path over as many parcels as fit: `shortest_tour`.
- Everywhere else: `solver_of`, which knows the value of every other state as well.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from drone_env.core.actions import Action, Event
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import TooLargeError
from drone_env.planning.tours import Position, shortest_tour, tour_actions

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
        TooLargeError: if the solution would take too much memory; `bounds` still gives bounds of it.
    """
    return solve_episode(Episode(task, seed=seed))


def best_of(task: TaskConfig, seed: int) -> Solution | None:
    """The optimum of a map, None if it is too large to be solved."""
    try:
        return solve(task, seed)
    except TooLargeError:
        return None


def require_solvable(task: TaskConfig) -> None:
    """Check that maps of a task are not too large to be solved.

    Raises:
        TooLargeError: if they are.
    """
    if not task.uniform and task.efficiency_needs_all:
        from drone_env.planning.legs import require_room  # Imported lazily: compiling takes seconds.

        require_room(task, task.deliveries, task.pads if task.charge_rate else 0, task.battery_capacity, task.max_steps)


def solve_episode(episode: Episode, solver: "Solver | None" = None) -> Solution:
    """The optimum from where an episode stands; the episode is left as it is.

    Args:
        episode: The episode.
        solver: A solver of this episode; None to make one if necessary.

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
    return (solver or solver_of(episode)).best_actions()


def solver_of(episode: Episode) -> "Solver":
    """The values of all states that can follow from an episode in flight, by the fastest solver that covers its task.

    Raises:
        EpisodeError: if the episode has not begun, or has ended.
        TooLargeError: if that would take more memory than `states.MAX_BYTES`.
    """
    # Imported lazily: compiling takes seconds.
    from drone_env.planning.legs import LegSolver, covers
    from drone_env.planning.solver import ExactSolver

    return LegSolver(episode) if covers(episode.task) else ExactSolver(episode)
