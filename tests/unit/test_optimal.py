"""The exact optimum against a brute-force search that knows nothing but the dynamics, and tours by hand."""

import random
from dataclasses import replace

import pytest

from drone_env.core.cells import Cell
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TASKS, TaskConfig, get_task
from drone_env.planning.optimal import shortest_tour, solve, solve_episode, tour_actions
from tests.brute_force import BruteForce


def small_task(rng: random.Random) -> TaskConfig:
    steps = rng.randint(1, 12)
    return replace(
        get_task("easy"),
        id=f"small_{rng.getrandbits(32)}",
        width=rng.randint(2, 5),
        height=rng.randint(2, 5),
        deliveries=rng.randint(1, 3),
        buildings=0,
        trees=0,
        obstacles=0,
        max_steps=steps,
        battery_capacity=rng.choice([steps, steps, rng.randint(1, 12)]),
    )


@pytest.mark.parametrize("seed", range(150))
def test_optimum_equals_brute_force_on_small_maps(seed: int) -> None:
    task = small_task(random.Random(seed))
    solution = solve(task, seed)
    episode = Episode(task)
    episode.reset(seed)
    assert solution.score == BruteForce(episode).value


@pytest.mark.parametrize("seed", range(40))
def test_optimum_from_the_middle_of_a_flight_equals_brute_force(seed: int) -> None:
    rng = random.Random(seed)
    episode = Episode(small_task(rng))
    episode.reset(seed)
    for _ in range(rng.randint(0, 4)):
        episode.step(rng.randrange(5))
    before = episode.get_state()
    solution = solve_episode(episode)
    assert episode.get_state() == before
    assert solution.score == (episode.score if episode.ended else BruteForce(episode).value)


@pytest.mark.parametrize("name", TASKS)
def test_the_actions_of_the_solution_earn_its_score(name: str) -> None:
    for seed in range(50):
        solution = solve(name, seed)
        episode = Episode(name)
        episode.reset(seed)
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
    assert shortest_tour((5, 0), parcels, budget=1) == []
    assert shortest_tour((5, 0), [], budget=10) == []


def test_sixteen_parcels_are_solved() -> None:
    parcels = [(i, 0) for i in range(1, 17)]
    random.Random(0).shuffle(parcels)
    assert shortest_tour((0, 0), parcels, budget=16) == [(i, 0) for i in range(1, 17)]


@pytest.mark.parametrize("needs_all", [False, True])
@pytest.mark.parametrize(
    "mechanics",
    [
        {"impassable": frozenset({Cell.OBSTACLE})},
        {"drain": ((Cell.BUILDING, 2),)},
        {"pads": 1, "charge_rate": 5},
        {},
    ],
)
def test_every_mechanic_is_solved(mechanics: dict, needs_all: bool) -> None:
    steps = {"max_steps": 20, "battery_capacity": 15, "efficiency_needs_all": needs_all}
    task = replace(get_task("easy"), id="custom", width=4, height=4, **steps, **mechanics)
    for seed in range(5):
        episode = Episode(task)
        episode.reset(seed)
        assert solve(task, seed).score == BruteForce(episode).value


def test_an_impassable_kind_that_no_map_holds_changes_nothing() -> None:
    task = replace(get_task("easy"), id="custom", obstacles=0, impassable=frozenset({Cell.OBSTACLE}))
    assert solve(task, 0).success
