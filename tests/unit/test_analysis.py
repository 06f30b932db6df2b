"""Flights move by move: what each gave away, by hand and to the last bit."""

import math
from fractions import Fraction
from functools import cache

import pytest

from drone_env.agents import make_agent
from drone_env.core.actions import Action, Event, Outcome
from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from drone_env.errors import EpisodeError, TooLargeError
from drone_env.planning.exact import ExactSolver
from drone_env.planning.optimal import solve, solve_episode
from drone_env.results.analysis import (
    LABELS,
    FlightAnalysis,
    analyse_actions,
    analyse_flight,
    label_of,
    parcel_value,
)
from drone_env.results.record import EpisodeRecord, record_of
from tests.toy import toy_episode
from tests.which_tasks import SMALL

SEED = 7
AGENTS = ("random", "greedy", "optimal")
LARGE = ("skyline_hard", "city_small")
EVERY_FLIGHT = [(task, agent) for task in SMALL for agent in AGENTS if task not in LARGE or agent == "random"]
"""The values of a map of skyline_hard take a second."""
MAP = ["@.0", "..."]
"""Two steps to the only parcel. With 4 steps: V* is 0.8 + 0.2 * 2/4 = 0.9 at the start, each step lost costs 0.05."""


def letters(actions: str) -> list[int]:
    return ["UDLRW".index(letter) for letter in actions]


@cache
def flown(task: str, agent: str) -> Episode:
    episode, pilot = Episode(task), make_agent(agent, task)
    pilot.reset(episode.reset(SEED))
    while not episode.ended:
        episode.step(pilot.act(episode.observation()))
    return episode


@cache
def analysed(task: str, agent: str) -> FlightAnalysis:
    return analyse_flight(record_of(flown(task, agent), agent))


def unfinished(task: str, actions: str) -> EpisodeRecord:
    episode = Episode(task)
    episode.reset(SEED)
    for action in letters(actions):
        episode.step(action)
    return record_of(episode, "someone")


def test_a_blunder_by_hand() -> None:
    start = toy_episode(MAP, max_steps=4)
    analysis = analyse_actions(start, letters("WWWW"), "sleeper")
    # After two waits the two steps left just reach the parcel; the third wait loses it, and then nothing matters.
    assert analysis.values == (0.9, 0.85, 0.8, 0.01, 0.01)
    assert [move.regret for move in analysis.moves] == [0.9 - 0.85, 0.85 - 0.8, 0.8 - 0.01, 0]
    assert [move.label for move in analysis.moves] == ["mistake", "mistake", "blunder", "best"]
    assert [move.mark for move in analysis.moves] == ["?", "?", "??", ""]
    assert [move.best_actions for move in analysis.moves] == [(Action.RIGHT,)] * 3 + [tuple(Action)]
    assert analysis.moves[-1].event is Event.BATTERY_DEAD
    assert analysis.outcome is Outcome.BATTERY_DEAD
    assert (analysis.optimum, analysis.score, analysis.regret) == (0.9, 0.01, 0.9 - 0.01)
    assert analysis.counts == {"best": 1, "good": 0, "inaccuracy": 0, "mistake": 2, "blunder": 1}
    assert (analysis.decisive, analysis.accuracy) == (3, 0)
    assert start.steps == 0
    summary = [line.split() for line in analysis.summary_lines()]
    assert ["mistake", "2", "0.10000", "?"] in summary
    assert ["blunder", "1", "0.79000", "??"] in summary


def test_the_only_move_by_hand() -> None:
    analysis = analyse_actions(toy_episode(MAP, max_steps=4), letters("WWRR"), "late")
    assert [move.mark for move in analysis.moves] == ["?", "?", "!!", "!!"]
    assert [move.margin for move in analysis.moves] == [0.9 - 0.85, 0.85 - 0.8, 0.8 - 0.01, 0.8 - 0.01]
    assert [move.position for move in analysis.moves] == [(0, 0), (0, 0), (1, 0), (2, 0)]
    assert analysis.moves[-1].event is Event.DELIVERY
    assert (analysis.score, analysis.accuracy) == (0.8, 0.5)


def test_all_equally_good_actions_are_named() -> None:
    (first, *_) = analyse_actions(toy_episode(["@.", ".0"]), letters("DR"), "either").moves
    assert (first.best_actions, first.label, first.mark) == ((Action.DOWN, Action.RIGHT), "best", "")
    (first, *_) = analyse_actions(toy_episode(["@.", ".0"]), letters("W"), "neither").moves
    assert first.best_actions == (Action.DOWN, Action.RIGHT)
    assert first.regret > 0


@pytest.mark.parametrize(("task", "agent"), EVERY_FLIGHT)
def test_regrets_add_up_to_optimum_minus_score_exactly(task: str, agent: str) -> None:
    analysis, episode = analysed(task, agent), flown(task, agent)
    flight = Episode(task)
    flight.reset(SEED)
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
    assert (analysis.optimum, analysis.score, analysis.ended) == (optimum, episode.score, True)
    assert analysis.regret == float(exact) == math.fsum(terms)
    before, after = analysis.values[:-1], analysis.values[1:]
    assert [move.regret for move in analysis.moves] == [a - b for a, b in zip(before, after, strict=True)]
    assert math.fsum(move.regret for move in analysis.moves) == pytest.approx(analysis.regret, abs=1e-12)


@pytest.mark.parametrize(("task", "agent"), EVERY_FLIGHT)
def test_a_blunder_loses_a_parcel_and_nothing_else_does(task: str, agent: str) -> None:
    analysis = analysed(task, agent)
    parcel = parcel_value(analysis.task)
    # On these tasks steps and battery left count only when all is delivered.
    parcels = [analysis.task.deliveries if value >= 0.8 else round(value / parcel) for value in analysis.values]
    for move, before, after in zip(analysis.moves, parcels, parcels[1:], strict=False):
        assert (move.label == "blunder") == (after < before)


@pytest.mark.parametrize("task", SMALL)
def test_the_optimal_agent_gives_nothing_away(task: str) -> None:
    analysis = analysed(task, "optimal")
    assert {move.label for move in analysis.moves} == {"best"}
    assert (analysis.regret, analysis.accuracy) == (0, 1)


def test_an_unfinished_flight_counts_as_waiting_to_the_end() -> None:
    analysis = analyse_flight(unfinished("easy", "WW"))
    flight = Episode("easy")
    flight.reset(SEED)
    flight.step(Action.WAIT)
    flight.step(Action.WAIT)
    reachable = solve_episode(flight).score
    assert [move.step for move in analysis.moves] == [1, 2]
    assert not analysis.ended
    assert analysis.giving_up is not None
    assert (analysis.score, analysis.outcome) == (0.01, Outcome.FLYING)
    assert (analysis.giving_up.value, analysis.giving_up.regret) == (reachable, reachable - 0.01)
    assert analysis.giving_up.label == "blunder"
    assert analysis.giving_up.best_actions == ExactSolver(flight).optimal_actions(flight)
    assert analysis.values == (solve("easy", SEED).score, analysis.moves[1].value, reachable, 0.01)
    assert analysis.counts["blunder"] == 0
    assert "Unfinished after 2 steps: counted as if it had waited to the end" in analysis.to_text()


def test_a_flight_without_moves_is_nothing_but_giving_up() -> None:
    analysis = analyse_flight(unfinished("easy", ""))
    assert (analysis.moves, analysis.accuracy, analysis.decisive) == ((), None, 0)
    assert analysis.values == (analysis.optimum, 0.01)
    assert "Accuracy -: " in analysis.to_text()


@pytest.mark.parametrize(
    ("parcels", "label"),
    [
        (0.0, "best"),
        (1e-9, "good"),
        (0.0079, "good"),
        (0.0081, "inaccuracy"),
        (0.049, "inaccuracy"),
        (0.051, "mistake"),
        (0.49, "mistake"),
        (0.51, "blunder"),
    ],
)
@pytest.mark.parametrize("task", ["easy_delivery", "hard_delivery"])
def test_labels_go_by_the_value_of_a_parcel(task: str, parcels: float, label: str) -> None:
    assert label_of(parcels * parcel_value(TASKS[task]), TASKS[task]) == label


@pytest.mark.parametrize("task", ["easy_delivery", "medium_delivery", "hard_delivery"])
def test_a_step_lost_is_good_and_a_wrong_turn_an_inaccuracy(task: str) -> None:
    # Every step costs 0.2 / max_steps here; a wrong turn costs two.
    step = 0.2 / TASKS[task].max_steps
    assert (label_of(step, TASKS[task]), label_of(2 * step, TASKS[task])) == ("good", "inaccuracy")


def test_json_says_all_of_it() -> None:
    analysis = analysed("skyline_medium", "random")
    report = analysis.to_dict()
    assert (report["task"], report["task_version"], report["seed"]) == ("skyline_medium", 2, SEED)
    assert (report["agent"], report["ended"], report["giving_up"]) == ("random", True, None)
    assert report["optimum"] - report["score"] == report["regret"] == analysis.regret
    assert list(report["counts"]) == list(LABELS)
    flight = Episode("skyline_medium", seed=SEED)
    for move in report["moves"]:
        assert (move["action"] in move["best_actions"]) == (move["regret"] == 0)
        flight.step(Action[move["action"]])
        assert (move["position"], move["event"]) == (list(flight.position), flight.event.name.lower())
    stopped = analyse_flight(unfinished("easy", "W")).to_dict()
    assert set(stopped["giving_up"]) == {"value", "regret", "label", "best_actions"}


def test_text_has_one_line_per_move_and_fits_a_terminal() -> None:
    analysis = analysed("hard_delivery", "random")
    title, _, heading, *lines = analysis.to_text().splitlines()
    assert title == "hard_delivery, map 7, flown by random"
    assert heading.split() == ["step", "move", "to", "event", "value", "regret", "better"]
    for move, line in zip(analysis.moves, lines, strict=False):
        assert line.split()[:2] == [str(move.step), move.action.name]
        assert f"  {move.value:.4f}" in line
        assert (" ?? " in line) == (move.label == "blunder")
        assert line.endswith(", ".join(action.name for action in move.best_actions)) or move.regret == 0
    assert lines[len(analysis.moves)] == ""
    assert max(map(len, lines)) <= 80
    assert f"Score {analysis.score:.4f}, optimum {analysis.optimum:.4f}, regret {analysis.regret:.5f}" in lines


def test_actions_after_the_end_are_refused() -> None:
    with pytest.raises(EpisodeError, match="ended"):
        analyse_actions(toy_episode(MAP, max_steps=4), letters("RRW"), "late")


def test_a_map_that_is_too_large_is_refused() -> None:
    rows = ["@" + "0123456789".ljust(63, "."), *["." * 64] * 63]
    with pytest.raises(TooLargeError, match=r"a map of .* would take .* GB"):
        analyse_actions(toy_episode(rows, max_steps=32_000), letters("R"), "giant")
