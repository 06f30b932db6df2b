"""Tours by hand, and that a solution can be flown. (That it is the best one: tests/property/test_exact.py.)"""

import random

from drone_env.planning.optimal import shortest_tour


def test_too_short_a_budget_delivers_as_many_as_it_can() -> None:
    parcels = [(0, 0), (9, 0), (3, 0)]
    assert shortest_tour((5, 0), parcels, budget=12) == [(3, 0), (0, 0)]
    assert shortest_tour((5, 0), parcels, budget=4) == [(3, 0)]
    assert shortest_tour((5, 0), parcels, budget=2) == [(3, 0)]
    assert shortest_tour((5, 0), parcels, budget=1) == []
    assert shortest_tour((5, 0), [], budget=10) == []


def test_sixteen_parcels_are_solved() -> None:
    parcels = [(i, 0) for i in range(1, 17)]
    random.Random(0).shuffle(parcels)
    assert shortest_tour((0, 0), parcels, budget=16) == [(i, 0) for i in range(1, 17)]
