"""Bounds of the optimum: never wrong, by hand as narrow as they are meant to be, and there where no planner is."""

from functools import partial
from typing import Any

import pytest

from drone_env.core.cells import Cell
from drone_env.core.episode import Episode, rollout
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.planning.bounds import bounds
from drone_env.planning.greedy import greedy_action
from drone_env.planning.optimal import solve
from tests.toy import fly, toy_episode
from tests.unit.test_audit import tiny_tasks
from tests.which_tasks import SMALL

LINE = ["0..1.@...2", ".........."]
"""The nearest first: 2 + 3 + 9 steps. Best: 4 + 6 + 3."""
WALLED = ["@.OO", "..O0", "1.OO"]
BLOCKED: dict[str, Any] = {"impassable": frozenset({Cell.OBSTACLE})}


def greedy_score(episode: Episode) -> float:
    return rollout(episode.copy(), partial(greedy_action, episode.task)).score


@pytest.mark.parametrize(
    ("drawing", "changes", "lower", "upper"),
    [
        (LINE, {"max_steps": 20}, 0.8 + 0.2 * 6 / 20, 0.8 + 0.2 * 7 / 20),
        # Two parcels fit into nine steps; above, they are delivered and the flight is over after a single step.
        (LINE, {"max_steps": 9}, 1.6 / 3, 1.6 / 3 + 0.2 * 8 / 9),
        # Nine parcels and an early end would score more than ten.
        (["@012345678..9", "............."], {"max_steps": 20}, 0.8 + 0.2 * 8 / 20, 0.72 + 0.2 * 19 / 20),
        # From the pad to the parcel four of five units are spent, after one step to charge; the chase does not charge.
        (
            ["@.P...0", "......."],
            {"max_steps": 20, "battery_capacity": 5, "charge_rate": 9},
            0.1 * 15 / 20,
            0.8 + 0.1 * 1 / 5 + 0.1 * 13 / 20,
        ),
        # What nothing leads to is not counted; what is left counts where efficiency does not need all.
        (WALLED, {"max_steps": 6, "efficiency_needs_all": True, **BLOCKED}, 0.4, 0.4),
        (WALLED, {"max_steps": 6, **BLOCKED}, 0.4, 0.4 + 0.2 * 5 / 6),
    ],
)
def test_by_hand(drawing: list[str], changes: dict[str, Any], lower: float, upper: float) -> None:
    assert bounds(toy_episode(drawing, **changes)) == pytest.approx((lower, upper), abs=1e-12)


def test_from_the_middle_of_a_flight_and_after_its_end() -> None:
    episode = toy_episode(["@.0.1", "....."], max_steps=20)
    fly(episode, "WWRR")
    before = episode.get_state()
    assert bounds(episode) == pytest.approx((0.94, 0.94))  # six steps of 20
    assert episode.get_state() == before
    fly(episode, "RR")
    assert bounds(episode) == (episode.score, episode.score)
    dead = toy_episode(["@..0", "...."], max_steps=20, battery_capacity=2)
    fly(dead, "WW")
    assert bounds(dead) == (dead.score, dead.score)


@pytest.mark.parametrize("task", SMALL)
def test_the_optimum_lies_between_its_bounds(task: str) -> None:
    for seed in split_seeds("test", 5 if get_task(task).width < 64 else 1):
        episode = Episode(task, seed=seed)
        lower, upper = bounds(episode)
        assert greedy_score(episode) == lower <= solve(task, seed).score <= upper
        if get_task(task).uniform:
            assert upper == solve(task, seed).score


def test_the_optimum_of_tiny_maps_lies_between_its_bounds() -> None:
    for seed, task in enumerate(tiny_tasks(60)):
        lower, upper = bounds(Episode(task, seed=seed))
        assert lower <= solve(task, seed).score <= upper
