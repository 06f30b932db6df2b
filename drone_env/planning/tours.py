"""Shortest tours, for tasks with equal costs of all steps and without impassable cells."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

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
    """The parcels of the best tour, in order: the most parcels within `budget` steps, in the fewest steps."""
    n = len(parcels)
    first = [distance(start, parcel) for parcel in parcels]
    legs = [[distance(a, b) for b in parcels] for a in parcels]
    lengths = [[UNREACHED] * n for _ in range(1 << n)]
    order = [0] * n
    visited = held_karp(first, legs, n, budget, lengths, order)
    return [parcels[i] for i in order[:visited]]


def held_karp(first: Any, legs: Any, n: int, budget: int, lengths: Any, order: Any) -> int:
    """Write the order of the best tour and return its number of places.

    The best tour visits the most places within the budget, in the fewest steps; ties go to the lowest numbers. Dynamic
    programming over (set of visited places, last place): Held and Karp, "A dynamic programming approach to sequencing
    problems", 1962. Time O(2^n n^2), memory O(2^n n). The function runs interpreted on lists and compiled on arrays.

    Args:
        first: Steps from the start to each place, [n].
        legs: Steps from place to place, [n][n].
        n: Number of places.
        budget: Maximum number of steps.
        lengths: Working memory, [2^n][n]; `lengths[visited][last]` becomes the steps of the shortest path that visits
            the set and ends at `last`, or `UNREACHED` if it is over budget.
        order: [n], receives the numbers of the places; entries after the returned number are undefined.
    """
    best, best_last, best_size = 0, 0, 0
    best_length = UNREACHED
    for visited in range(1, 1 << n):
        size = 0
        for last in range(n):
            lengths[visited][last] = UNREACHED
            size += visited >> last & 1
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
            if size > best_size or (size == best_size and shortest < best_length):
                best, best_last, best_size, best_length = visited, last, size, shortest

    visited, last = best, best_last
    for place in range(best_size - 1, -1, -1):
        order[place] = last
        length = lengths[visited][last]
        visited ^= 1 << last
        for i in range(n):
            if visited >> i & 1 and lengths[visited][i] + legs[i][last] == length:
                last = i
                break
    return best_size
