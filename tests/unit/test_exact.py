"""The exact planners: one agrees with the other, their best flights, and what they refuse.

Beside brute force: tests/property/test_exact.py.
"""

import os
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
import pytest

from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import EpisodeError, TooLargeError, UnsupportedTaskError
from drone_env.planning import states
from drone_env.planning.legs import LegSolver
from drone_env.planning.optimal import best_actions, solve, solve_episode
from drone_env.planning.solver import ExactSolver, Solver
from drone_env.planning.states import battery_ranges
from drone_env.planning.tours import shortest_tour
from tests.brute_force import best_score
from tests.toy import fly, toy_episode

MakeSolver: TypeAlias = Callable[[Episode], Solver]


def test_of_equally_good_actions_the_lowest_number_is_flown() -> None:
    assert ExactSolver(toy_episode(["@.", ".0"])).best_actions() == [Action.DOWN, Action.RIGHT]


@pytest.mark.parametrize("make", [ExactSolver, LegSolver])
class TestRefusals:
    def test_an_episode_that_has_not_begun(self, make: MakeSolver) -> None:
        with pytest.raises(EpisodeError, match="reset"):
            make(Episode("skyline_easy"))
        solver = make(Episode("skyline_easy", seed=0))
        with pytest.raises(EpisodeError, match="reset"):
            solver.value(Episode("skyline_easy"))

    def test_an_episode_that_has_ended(self, make: MakeSolver) -> None:
        episode = toy_episode(["@0", ".."])
        solver = make(episode)
        fly(episode, "R")
        with pytest.raises(EpisodeError, match="ended"):
            make(episode)
        for refused in (solver.q_values, solver.optimal_actions):
            with pytest.raises(EpisodeError, match="ended"):
                refused(episode)
        assert solver.value(episode) == episode.score
        assert best_actions(episode) == []
        assert solve_episode(episode).actions == ()

    def test_an_episode_of_another_map_or_task(self, make: MakeSolver) -> None:
        solver = make(Episode("skyline_easy", seed=1).fly([Action.WAIT]))
        earlier, beside = Episode("skyline_easy", seed=1), Episode("skyline_easy", seed=1).fly([Action.UP, Action.WAIT])
        for other in (Episode("skyline_easy", seed=2), Episode("skyline_medium", seed=1), earlier, beside):
            with pytest.raises(EpisodeError, match="create a solver for this episode"):
                solver.q_values(other)

    def test_more_memory_than_is_allowed(self, make: MakeSolver, monkeypatch: pytest.MonkeyPatch) -> None:
        episode = Episode("skyline_easy", seed=0)
        monkeypatch.setattr(states, "MAX_BYTES", 50_000)
        with pytest.raises(TooLargeError, match="'skyline_easy' would take"):
            make(episode)
        with pytest.raises(TooLargeError, match="'skyline_easy' would take"):
            solve("skyline_easy", 0)


def test_many_parcels_are_solved() -> None:
    parcels = [(i * 7 % 11, 0) for i in range(1, 11)]
    assert shortest_tour((0, 0), parcels, budget=10) == [(i, 0) for i in range(1, 11)]


def test_the_largest_task_at_once() -> None:
    largest = {"width": 64, "height": 64, "deliveries": 16, "max_steps": 32_000, "battery_capacity": 32_000}
    for needs_all in (False, True):
        changes = {"drain": ((Cell.ROAD, 2),), "efficiency_needs_all": needs_all, **largest}
        with pytest.raises(TooLargeError, match=r"1\.1 GB are allowed"):
            best_actions(Episode(replace(get_task("easy"), id="largest", **changes), seed=0))


# By legs


TIMES = 20 if int(os.environ.get("DRONE_ENV_EXAMPLES", "0")) >= 10_000 else 1
"""A thorough run compares more maps."""
COMPARED = {"easy": 3, "medium": 1, "skyline_easy": 3}
"""Maps of each task; on larger ones the exact solver takes seconds."""


def random_states(episode: Episode, count: int) -> npt.NDArray[np.int64]:
    """States that a map can be in, int64[N, 4]: set delivered, cell, battery units and steps left."""
    draw, task = np.random.default_rng(episode.seed), episode.task
    lowest, sizes = battery_ranges(episode)
    grid = episode.grid().ravel()
    parcels = [y * task.width + x for x, y, _ in episode.parcels]
    t = draw.integers(len(sizes), size=count)
    delivered = draw.integers((1 << len(parcels)) - 1, size=count)
    cells = draw.choice(np.flatnonzero(~np.isin(grid, list(task.impassable))), count)
    waits = np.array([[cell == parcel for parcel in parcels] for cell in cells]) @ (1 << np.arange(len(parcels)))
    states = np.stack([delivered, cells, lowest[t] + draw.integers(sizes[t]), task.max_steps - t], axis=1)
    return states[waits & ~delivered == 0]


@pytest.mark.parametrize("task", [*COMPARED, pytest.param("skyline_medium", marks=pytest.mark.long)])
def test_every_state_has_the_value_that_the_exact_solver_gives_it(task: str) -> None:
    for seed in split_seeds("test", TIMES * COMPARED.get(task, 1)):
        episode = Episode(task, seed=seed)
        states = random_states(episode, 3000)
        exact, legs = ExactSolver(episode), LegSolver(episode)
        assert len(states) > 1000
        assert np.array_equal(exact._values_in_flight(states), legs._values_in_flight(states))


@pytest.mark.parametrize("maps", [2, pytest.param(100, marks=pytest.mark.campaign)])
@pytest.mark.parametrize("task", ["skyline_easy", "rush_easy", "rush_medium", "rush_hard"])
def test_the_optimum_is_what_flying_every_action_reaches(task: str, maps: int) -> None:
    for seed in split_seeds("test", maps):
        assert solve(task, seed).score == best_score(Episode(task, seed=seed)), seed


@pytest.mark.parametrize("task", ["medium", "skyline_hard", "rush_hard", "city"])
def test_a_best_flight_reaches_the_value_of_the_start(task: str) -> None:
    for seed in split_seeds("test", TIMES * (1 if task == "city" else 5)):
        start = Episode(task, seed=seed)
        solver = LegSolver(start)
        flight = start.copy().fly(solver.best_actions())
        assert solve(task, seed).score == solver.value(start) == flight.counted_score()


def test_a_task_whose_efficiency_always_counts_and_whose_steps_differ_is_refused() -> None:
    with pytest.raises(UnsupportedTaskError, match="needs equal costs of all steps, or efficiency_needs_all"):
        LegSolver(toy_episode(["@B0", "..."], drain=((Cell.BUILDING, 2),)))


def test_of_best_flights_the_shortest_is_flown() -> None:
    # One parcel is out of reach. For the other the battery does not last, and there is time to fill it at either pad.
    walled = {"impassable": frozenset({Cell.OBSTACLE}), "charge_rate": 9, "efficiency_needs_all": True}
    episode = toy_episode(["P.@.P...0", "OOOOOOOOO", "1........"], max_steps=40, battery_capacity=5, **walled)
    assert "".join("UDLRW"[action] for action in LegSolver(episode).best_actions()) == "RRWRRRR"
