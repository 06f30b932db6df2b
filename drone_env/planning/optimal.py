"""The exact optimum: the shortest tour over all orders of delivery, or the most parcels that the battery can reach.

Where every step costs one battery unit and nothing blocks the way, the score grows with each parcel, and with all
parcels delivered it falls with each step; an episode that does not deliver all lasts until the battery or the steps
run out, so then only the number of parcels counts. The best flight is therefore the shortest path over all parcels
if it fits into the budget of steps, else any path over as many parcels as fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from drone_env.core.actions import Action
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.planning.held_karp import UNREACHED, held_karp
from drone_env.planning.paths import Position, distance, require_uniform, route


@dataclass(frozen=True)
class Solution:
    """The best that can be made of an episode, flown to its end with the real dynamics.

    Attributes:
        score: The highest score that can be reached.
        success: Whether all parcels can be delivered.
        steps: Steps from here to the end of the episode.
        deliveries: Parcels delivered at the end.
        order: (x, y) of the parcels still to deliver, in the order in which the tour visits them.
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
        UnsupportedTaskError: if the task is not `uniform`.
    """
    episode = Episode(get_task(task))
    episode.reset(seed)
    return solve_episode(episode)


def best_of(task: TaskConfig, seed: int) -> Solution | None:
    """The optimum of a map, None on a task that no planner solves exactly."""
    return solve(task, seed) if task.uniform else None


def solve_episode(episode: Episode) -> Solution:
    """The optimum from where an episode stands; the episode is left as it is.

    Raises:
        UnsupportedTaskError: if the task is not `uniform`.
    """
    require_uniform(episode.task)
    flight = Episode(episode.task, episode.reward_profile)
    flight.set_state(episode.get_state())
    waiting = [(x, y) for x, y, delivered in episode.parcels if not delivered]
    budget = min(episode.battery_units, episode.task.max_steps - episode.steps)
    tour = shortest_tour(episode.position, waiting, budget)
    for action in tour_actions(episode.position, tour):
        flight.step(action)
    while not flight.ended:
        flight.step(Action.WAIT)
    actions = tuple(Action(action) for action in flight.actions[episode.steps :])
    return Solution(flight.score, flight.success, len(actions), flight.deliveries_done, tuple(tour), actions)


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
