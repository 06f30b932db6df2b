"""Flights move by move: what each gave away, by hand and to the last bit."""

import math
from collections.abc import Iterable
from fractions import Fraction

import pytest

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from drone_env.flights.record import record_of
from drone_env.planning.optimal import solve, solve_episode
from drone_env.planning.solver import ExactSolver
from drone_env.results.analysis import (
    analyse_actions,
    analyse_flight,
    find_loops,
    label_of,
    parcel_value,
)
from tests.api.flying import flown
from tests.toy import toy_episode

SEED = 7
MAP = ["@.0", "..."]
"""Two steps to the only parcel. With 4 steps: V* is 0.8 + 0.2 * 2/4 = 0.9 at the start, each step lost costs 0.05."""


def letters(actions: str) -> list[int]:
    return ["UDLRW".index(letter) for letter in actions]


def letters_of(actions: Iterable[Action]) -> str:
    return "".join(action.name[0] for action in actions)


def test_a_blunder_by_hand() -> None:
    start = toy_episode(MAP, max_steps=4)
    analysis = analyse_actions(start, letters("WWWW"))
    # After two waits the two steps left just reach the parcel; the third wait loses it, and then nothing matters.
    assert analysis.values == (0.9, 0.85, 0.8, 0.01, 0.01)
    assert [move.regret for move in analysis.moves] == [0.9 - 0.85, 0.85 - 0.8, 0.8 - 0.01, 0]
    assert [move.label for move in analysis.moves] == ["mistake", "mistake", "blunder", "best"]
    assert [move.mark for move in analysis.moves] == ["?", "?", "??", ""]
    assert [move.best_actions for move in analysis.moves] == [(Action.RIGHT,)] * 3 + [tuple(Action)]
    assert (analysis.optimum, analysis.score, analysis.regret) == (0.9, 0.01, 0.9 - 0.01)
    assert start.steps == 0


def test_the_only_move_by_hand() -> None:
    analysis = analyse_actions(toy_episode(MAP, max_steps=4), letters("WWRR"))
    assert [move.mark for move in analysis.moves] == ["?", "?", "!!", "!!"]
    assert [move.margin for move in analysis.moves] == [0.9 - 0.85, 0.85 - 0.8, 0.8 - 0.01, 0.8 - 0.01]
    assert analysis.score == 0.8


@pytest.mark.parametrize(
    ("drawing", "actions", "loop"),
    [
        (MAP, "WWWWWWW", (1, 7, "W", "stayed on one cell for 7 steps", 6)),
        (MAP, "DLLLLLL", (2, 7, "L", "flew against an edge or an obstacle for 6 steps", 5)),
        (MAP, "RLRLRLRR", (1, 6, "RL", "flew back and forth for 6 steps", 5)),
        (["0@.", "..1"], "LRDLURDLURDLUR", (2, 13, "RDLU", "flew in circles for 12 steps", 11)),
        # The first wait on the pad fills the battery.
        (["P@.", "..0"], "LWWRLWRLWRLW", (3, 11, "WRL", "circled a pad for 9 steps", 8)),
        (["P@.", "..0"], "RRRLLWWWWWW", (6, 11, "W", "stayed on a pad for 6 steps", 1)),
        (MAP, "RLRL", None),
        (["@.......", ".......0"], "RRRRRRR", None),  # the same action over other cells
    ],
)
def test_loops_by_hand(drawing: list[str], actions: str, loop: tuple[int, int, str, str, int] | None) -> None:
    flown = toy_episode(drawing, max_steps=20, charge_rate=1).fly(letters(actions))
    found = [(one.first, one.last, letters_of(one.actions), one.words, one.idle) for one in find_loops(flown)]
    assert found == ([] if loop is None else [loop])


def test_a_loop_is_blamed_as_a_whole_not_its_last_step() -> None:
    # After seven waits the two steps left no longer reach the parcel.
    analysis = analyse_actions(toy_episode(MAP, max_steps=8), letters("WWWWWWWR"))
    assert max(analysis.moves, key=lambda move: move.regret).step == 7
    [worst] = analysis.loops
    assert analysis.worst == worst
    assert (worst.first, worst.last, worst.regret, worst.mark) == (1, 7, analysis.values[0] - 0.01, "??")
    assert analysis.worst_why == "stayed on one cell for 7 steps"
    assert analysis.why == "The drone stayed on one cell for 7 steps (1 to 7); then the battery was empty."


def test_a_failed_flight_that_lost_nothing_is_not_blamed() -> None:
    analysis = analyse_actions(toy_episode(["@...", "...0"], max_steps=3), letters("WWW"))
    assert (analysis.regret, analysis.worst, analysis.why) == (0, None, "No flight over this map scores more.")


@pytest.mark.parametrize(
    ("task", "agent"), [("easy", "random"), ("hard", "greedy"), ("skyline_easy", "optimal"), ("rush_easy", "greedy")]
)
def test_regrets_add_up_to_optimum_minus_score_exactly(task: str, agent: str) -> None:
    episode = flown(task, agent)
    analysis = analyse_flight(record_of(episode, agent))
    flight = Episode(task, seed=SEED)
    solver = ExactSolver(flight)
    exact = Fraction(0)
    terms = []
    for action in episode.actions:
        values = solver.q_values(flight)
        terms += [float(values.max()), -float(values[action])]
        exact += Fraction(terms[-2]) + Fraction(terms[-1])
        flight.step(action)
        assert solver.value(flight) == values[action]
    optimum = solve(task, SEED).score
    assert exact == Fraction(optimum) - Fraction(episode.score)
    assert (analysis.optimum, analysis.score, analysis.values[-1]) == (optimum, episode.score, episode.score)
    assert analysis.regret == float(exact) == math.fsum(terms)


def test_an_unfinished_flight_counts_as_waiting_to_the_end() -> None:
    flight = Episode("easy", seed=SEED).fly(letters("WW"))
    analysis = analyse_flight(record_of(flight, "someone"))
    assert (analysis.score, analysis.flown.ended) == (0.01, False)
    assert analysis.values == (solve("easy", SEED).score, analysis.moves[1].value, solve_episode(flight).score)


@pytest.mark.parametrize("task", ["easy_delivery", "hard_delivery"])
def test_labels_go_by_the_value_of_a_parcel(task: str) -> None:
    parcels = (0.0, 1e-9, 0.0079, 0.0081, 0.049, 0.051, 0.49, 0.51)
    labels = [label_of(regret * parcel_value(TASKS[task]), TASKS[task]) for regret in parcels]
    assert labels == ["best", "good", "good", "inaccuracy", "inaccuracy", "mistake", "mistake", "blunder"]
    # Every step costs 0.2 / max_steps here; a wrong turn costs two.
    step = 0.2 / TASKS[task].max_steps
    assert (label_of(step, TASKS[task]), label_of(2 * step, TASKS[task])) == ("good", "inaccuracy")
