"""What the exact planners refuse. (Their values: tests/property/test_exact.py, tests/unit/test_legs.py.)"""

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import pytest

from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.errors import EpisodeError, TooLargeError
from drone_env.planning import states
from drone_env.planning.legs import LegSolver
from drone_env.planning.optimal import best_actions, solve, solve_episode
from drone_env.planning.solver import ExactSolver, Solver
from drone_env.planning.tours import shortest_tour
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
        with pytest.raises(EpisodeError, match="ended"):
            solver.regret(episode, 0)
        assert solver.value(episode) == episode.score
        assert best_actions(episode) == []
        assert solve_episode(episode).actions == ()

    def test_an_episode_of_another_map_or_task(self, make: MakeSolver) -> None:
        solver = make(Episode("skyline_easy", seed=1).fly([Action.WAIT]))
        earlier, beside = Episode("skyline_easy", seed=1), Episode("skyline_easy", seed=1).fly([Action.UP, Action.WAIT])
        for other in (Episode("skyline_easy", seed=2), Episode("skyline_medium", seed=1), earlier, beside):
            with pytest.raises(EpisodeError, match="create a solver for this episode"):
                solver.q_values(other)

    def test_another_terrain_or_other_parcels_under_the_same_seed(self, make: MakeSolver) -> None:
        solver = make(toy_episode(["@B.", "0.1"]))
        for other in (["@.B", "0.1"], ["@B.", "1.0"], ["@B.", "01."]):
            with pytest.raises(EpisodeError, match="create a solver for this episode"):
                solver.value(toy_episode(other))
        elsewhere = toy_episode([".B@", "0.1"])  # the drone can be there, though it has not flown there
        assert solver.value(elsewhere) == make(elsewhere).value(elsewhere)

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
