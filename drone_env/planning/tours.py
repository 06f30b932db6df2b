"""Shortest tours, for tasks with equal costs of all steps and without impassable cells."""

from collections.abc import Sequence
from itertools import pairwise

from drone_env.core.actions import Action

Position = tuple[int, int]
UNREACHED = 1 << 30


def distance(a: Position, b: Position) -> int:
    """Steps from one position to another."""
    return abs(a[0] - b[0]) + abs(a[1] - b[1])


def route(a: Position, b: Position) -> list[Action]:
    """The actions of a shortest path: along the row first."""
    sideways = [Action.RIGHT if b[0] > a[0] else Action.LEFT] * abs(b[0] - a[0])
    return sideways + [Action.DOWN if b[1] > a[1] else Action.UP] * abs(b[1] - a[1])


def tour_actions(start: Position, tour: Sequence[Position]) -> list[Action]:
    """The actions that visit the positions of a tour in order."""
    stops = [start, *tour]
    return [action for a, b in pairwise(stops) for action in route(a, b)]


def shortest_tour(start: Position, parcels: Sequence[Position], budget: int) -> list[Position]:
    """The parcels of the best tour, in order: the most parcels within `budget` steps, in the fewest steps.

    Ties go to the lowest numbers. Dynamic programming over (set of visited parcels, last parcel): Held and Karp, "A
    dynamic programming approach to sequencing problems", 1962. Time O(2^n n^2), memory O(2^n n).
    """
    n = len(parcels)
    first = [distance(start, parcel) for parcel in parcels]
    legs = [[distance(a, b) for b in parcels] for a in parcels]
    # The steps of the shortest path that visits a set and ends at a parcel, or `UNREACHED` if it is over budget.
    lengths = [[UNREACHED] * n for _ in range(1 << n)]
    best, best_visited, best_last = (0, 0), 0, 0
    for visited in range(1, 1 << n):
        for last in range(n):
            if not visited >> last & 1:
                continue
            before = visited ^ (1 << last)
            shortest = first[last] if before == 0 else UNREACHED
            for i in range(n):
                if before >> i & 1 and lengths[before][i] + legs[i][last] < shortest:
                    shortest = lengths[before][i] + legs[i][last]
            if shortest > budget:
                continue
            lengths[visited][last] = shortest
            if (visited.bit_count(), -shortest) > best:
                best, best_visited, best_last = (visited.bit_count(), -shortest), visited, last

    order, visited, last = list[Position](), best_visited, best_last
    for _ in range(best[0]):
        order.insert(0, parcels[last])
        length = lengths[visited][last]
        visited ^= 1 << last
        for i in range(n):
            if visited >> i & 1 and lengths[visited][i] + legs[i][last] == length:
                last = i
                break
    return order
