"""The values by legs are those of the exact solver; its best flights reach them, and are the shortest that do."""

import os

import numpy as np
import numpy.typing as npt
import pytest

from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.errors import UnsupportedTaskError
from drone_env.planning.legs import LegSolver
from drone_env.planning.optimal import solve
from drone_env.planning.solver import ExactSolver
from drone_env.planning.states import battery_ranges
from tests.brute_force import best_score
from tests.toy import toy_episode

TIMES = 20 if int(os.environ.get("DRONE_ENV_EXAMPLES", "0")) >= 10_000 else 1
"""A thorough run compares more maps."""
COMPARED = {"easy": 5, "medium": 2, "hard": 1, "skyline_easy": 5, "skyline_medium": 1}
"""Maps of each task; on skyline_hard the exact solver takes seconds."""


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


@pytest.mark.parametrize("task", [*COMPARED, pytest.param("skyline_hard", marks=pytest.mark.long)])
def test_every_state_has_the_value_that_the_exact_solver_gives_it(task: str) -> None:
    for seed in split_seeds("test", TIMES * COMPARED.get(task, 1)):
        episode = Episode(task, seed=seed)
        states = random_states(episode, 3000)
        exact, legs = ExactSolver(episode), LegSolver(episode)
        assert len(states) > 1000
        assert np.array_equal(exact._values_in_flight(states), legs._values_in_flight(states))


@pytest.mark.parametrize("maps", [2, pytest.param(100, marks=pytest.mark.long)])
@pytest.mark.parametrize("task", ["skyline_easy", "rush_easy", "rush_medium", "rush_hard"])
def test_the_optimum_is_what_flying_every_action_reaches(task: str, maps: int) -> None:
    for seed in split_seeds("test", maps):
        assert solve(task, seed).score == best_score(Episode(task, seed=seed)), seed


@pytest.mark.parametrize("task", [*COMPARED, "skyline_hard", "rush_hard", "city_small", "city"])
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
