"""The values by legs: those of the exact solver in every state that it holds, those of other planners on many maps."""

import os
from typing import Any

import pytest
from numba.extending import register_jitable

from drone_env.core import compiled
from drone_env.core.cells import Cell
from drone_env.core.compile_cache import compiled_once
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.errors import UnsupportedTaskError
from drone_env.planning.exact import ExactSolver, Values
from drone_env.planning.legs import (
    Legs,
    LegSolver,
    begin_row,
    best_option,
    mark_delivered,
    raise_by_ways,
    row_of,
)
from drone_env.planning.optimal import solve
from drone_env.planning.ways import Rounds, Ways, find_ways
from tests import most_battery
from tests.toy import toy_episode

THOROUGH = int(os.environ.get("DRONE_ENV_EXAMPLES", "0")) >= 10_000
COMPARED = {"easy": (10, 200), "medium": (3, 50), "hard": (1, 5)}
"""Maps of which every state is compared, of each size: in any run, and in a thorough one."""
PLANNED = {"easy": (40, 20_000), "medium": (40, 20_000), "hard": (15, 10_000)}
"""Maps whose optimum is compared, of the standard task and of the Skyline one; 100,000 in a thorough run."""


@register_jitable
def holds(values: Values, t: int, units: int, counts: int) -> bool:
    """Whether the exact solver has values of so many units after t steps; of any if they do not count."""
    most = (values.starts[t + 1] - values.starts[t]) // len(values.graph.leads_to)
    return 0 <= units - values.lowest[t] < most if counts else most > 0


@compiled_once(**compiled.OPTIONS)
def count_differences(values: Values, legs: Legs, ways: Ways, rounds: Rounds) -> Any:
    """In how many states the ranks differ, and how many were compared."""
    graph, _, lowest, starts, _, ranks = values
    places, cells, last = len(graph.leads_to), graph.tables.cells, len(starts) - 1
    differ, compared = 0, 0
    spare = row_of(legs, 0, 0, 0)
    for place in range(places):
        if graph.leads_to[place, 0] < 0:
            continue
        delivered, cell = place // cells, place % cells
        done = mark_delivered(legs, delivered)
        find_ways(legs.tables, legs.ground, cell, legs.most, legs.counts, legs.stop_at, ways, 0, rounds)
        at = legs.stop_at[cell]
        for units in range(1, legs.most + 1):
            row = row_of(legs, delivered, at, units) if at >= legs.parcels else spare
            if row == spare:
                begin_row(legs, done, units, row)
                raise_by_ways(legs, delivered, done, ways, 0, units, row, 0, len(legs.stops))
            for t in range(last):
                if holds(values, t, units, legs.counts):
                    compared += 1
                    rank = ranks[starts[t] + place + legs.counts * (units - lowest[t]) * places]
                    left = last - t if legs.counts else min(last - t, lowest[t])
                    differ += rank != legs.ranks[row, left]
        # The same of a single state, as a solver is asked for it: of one state in `last`, since that takes longer.
        for units in range(1, legs.most + 1):
            t = (place + 7 * units) % last
            if holds(values, t, units, legs.counts):
                rank = ranks[starts[t] + place + legs.counts * (units - lowest[t]) * places]
                left = last - t if legs.counts else min(last - t, lowest[t])
                differ += rank != best_option(legs, delivered, cell, units, left, ways, rounds)[0]
    return differ, compared


def assert_equal_everywhere(episode: Episode, states: int) -> None:
    exact, legs = ExactSolver(episode), LegSolver(episode)
    differ, compared = count_differences(exact._values, legs.legs, legs.ways, legs.rounds)
    assert differ == 0
    assert compared >= states


@pytest.mark.parametrize("size", COMPARED)
@pytest.mark.parametrize("prefix", ["skyline_", ""])
def test_every_state_has_the_value_that_the_exact_solver_gives_it(prefix: str, size: str) -> None:
    for seed in split_seeds("test", COMPARED[size][THOROUGH]):
        assert_equal_everywhere(Episode(prefix + size, seed=seed), states=1000)


@pytest.mark.parametrize("task", ["city_small", "city"])
def test_the_optimum_of_a_city_is_that_of_a_planner_that_shares_nothing_with_legs(task: str) -> None:
    for seed in split_seeds("test", 30 if THOROUGH else 2):
        flight = Episode(task, seed=seed).fly(most_battery.best_actions(Episode(task, seed=seed)))
        assert solve(task, seed).score == flight.counted_score()


@pytest.mark.parametrize("size", PLANNED)
def test_the_optimum_is_that_of_planners_that_share_nothing_with_legs(size: str) -> None:
    for seed in split_seeds("test", PLANNED[size][THOROUGH]):
        skyline = Episode(f"skyline_{size}", seed=seed)
        flight = skyline.copy().fly(most_battery.best_actions(skyline))
        assert solve(skyline.task, seed).score == LegSolver(skyline).value(skyline) == flight.counted_score()
        standard = Episode(size, seed=seed)
        flight = standard.copy().fly(LegSolver(standard).best_actions())
        assert solve(standard.task, seed).score == LegSolver(standard).value(standard) == flight.counted_score()


def test_a_task_whose_efficiency_always_counts_and_whose_steps_differ_is_refused() -> None:
    with pytest.raises(UnsupportedTaskError, match="every step costs the same, or where efficiency needs all"):
        LegSolver(toy_episode(["@B0", "..."], drain=((Cell.BUILDING, 2),)))


def test_of_best_flights_the_shortest_is_flown() -> None:
    # One parcel is out of reach. For the other the battery does not last, and there is time to fill it at either pad.
    walled = {"impassable": frozenset({Cell.OBSTACLE}), "charge_rate": 9, "efficiency_needs_all": True}
    episode = toy_episode(["P.@.P...0", "OOOOOOOOO", "1........"], max_steps=40, battery_capacity=5, **walled)
    assert "".join("UDLRW"[action] for action in LegSolver(episode).best_actions()) == "RRWRRRR"
