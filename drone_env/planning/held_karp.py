"""The shortest path over as many places as a budget allows, by dynamic programming.

Held and Karp, "A dynamic programming approach to sequencing problems", 1962: over (set of places visited, last one).
Time O(2^n n^2), memory O(2^n n). The function runs interpreted on lists and compiled on arrays.
"""

from typing import Any

UNREACHED = 1 << 30


def held_karp(first: Any, legs: Any, n: int, budget: int, lengths: Any, order: Any) -> int:
    """Write the order in which to visit the places and return how many of them fit into the budget.

    As many as possible, in as few steps as that takes; of equals the lowest numbers.

    Args:
        first: Steps from the start to each place, [n].
        legs: Steps from place to place, [n][n].
        n: How many places.
        budget: Steps that may be taken.
        lengths: Working memory, [2^n][n]; `lengths[visited][last]` becomes the steps of the shortest path that visits
            the set and ends at `last`, `UNREACHED` where the budget allows none.
        order: [n], receives the numbers of the places; what stands behind those that fit has no meaning.
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
