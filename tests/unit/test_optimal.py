"""Tours by hand, and that a solution can be flown. (That it is the best one: tests/property/test_exact.py.)"""

import random
from dataclasses import replace

import pytest

from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.planning.optimal import shortest_tour, solve, tour_actions
from tests.which_tasks import SMALL


@pytest.mark.parametrize("name", SMALL)
def test_the_actions_of_the_solution_earn_its_score(name: str) -> None:
    for seed in range(50):
        solution = solve(name, seed)
        episode = Episode(name, seed=seed)
        for action in solution.actions:
            assert not episode.ended
            episode.step(action)
        assert episode.ended
        assert (episode.score, episode.success, episode.steps, episode.deliveries_done) == (
            solution.score,
            solution.success,
            solution.steps,
            solution.deliveries,
        )


def test_tour_on_a_line_by_hand() -> None:
    # From 5: the three parcels left of it cost 5 steps one way, the far one on the right 4. Right first: 4 + 9 = 13.
    parcels = [(0, 0), (9, 0), (3, 0)]
    assert shortest_tour((5, 0), parcels, budget=100) == [(9, 0), (3, 0), (0, 0)]
    assert len(tour_actions((5, 0), shortest_tour((5, 0), parcels, budget=100))) == 13


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


def test_an_impassable_kind_that_no_map_holds_changes_nothing() -> None:
    task = replace(get_task("easy"), id="custom", obstacles=0, impassable=frozenset({Cell.OBSTACLE}))
    assert solve(task, 0).success
