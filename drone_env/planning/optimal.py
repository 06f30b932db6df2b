"""The exact optimum of a map, by the fastest planner that covers its task.

- Uniform tasks: the score increases with each parcel. If all are delivered, it decreases with each step. If not,
  the episode lasts until battery or steps run out, so only the number of parcels counts. The best flight is therefore
  the shortest path over all parcels, or over the most parcels within the budget of steps: `shortest_tour`.
- All other tasks: `solver_of`, which also computes the values of all other states.
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
    """A best flight from the current state of an episode to its end.

    Attributes:
        score: The highest possible score.
        success: Whether all parcels are delivered.
        steps: Steps to the end of the episode.
        deliveries: Parcels delivered at the end.
        order: (x, y) of the parcels in the order of delivery.
        actions: One best sequence of actions to the end.
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
        TooLargeError: if the solution would take too much memory.
    """
    return solve_episode(Episode(task, seed=seed))


def best_of(task: TaskConfig, seed: int) -> Solution | None:
    """The optimum of a map, or None if the map is too large."""
    try:
        return solve(task, seed)
    except TooLargeError:
        return None


def require_solvable(task: TaskConfig) -> None:
    """Check that the maps of a task are not too large to solve.

    Raises:
        TooLargeError: if they are too large.
    """
    if not task.uniform and task.efficiency_needs_all:
        from drone_env.planning.legs import require_room  # Imported lazily: compiling takes seconds.

        require_room(task, task.deliveries, task.pads if task.charge_rate else 0, task.battery_capacity, task.max_steps)


def solve_episode(episode: Episode, solver: "Solver | None" = None) -> Solution:
    """The optimum from the current state of an episode, which is not changed.

    Args:
        episode: The episode.
        solver: A solver of this episode; None to create one if necessary.

    Raises:
        TooLargeError: if the solution would take too much memory.
    """
    flight = episode.copy().fly(best_actions(episode, solver)).waited_out()
    path = flight.path[len(episode.actions) :]
    order = tuple((point.x, point.y) for point in path if point.event is Event.DELIVERY)
    actions = tuple(point.action for point in path)
    return Solution(flight.score, flight.success, len(actions), flight.deliveries_done, order, actions)


def best_actions(episode: Episode, solver: "Solver | None" = None) -> list[Action]:
    """The actions of a best flight from the current state of an episode.

    If the episode has not ended after them, only waiting remains.

    Args:
        episode: The episode.
        solver: As in `solve_episode`.
    """
    if episode.ended:
        return []
    if episode.task.uniform:
        waiting = [(x, y) for x, y, delivered in episode.parcels if not delivered]
        budget = min(episode.battery_units, episode.task.max_steps - episode.steps)
        return tour_actions(episode.position, shortest_tour(episode.position, waiting, budget))
    return (solver or solver_of(episode)).best_actions()


def solver_of(episode: Episode) -> "Solver":
    """The fastest solver that covers the task of an episode in flight.

    Raises:
        EpisodeError: if the episode has not started, or has ended.
        TooLargeError: if the solver would take more memory than `states.MAX_BYTES`.
    """
    # Imported lazily: compiling takes seconds.
    from drone_env.planning.legs import LegSolver, covers
    from drone_env.planning.solver import ExactSolver

    return LegSolver(episode) if covers(episode.task) else ExactSolver(episode)
