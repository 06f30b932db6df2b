"""How sure a comparison is: figures and intervals by hand, and the command."""

import json
from pathlib import Path

import numpy as np
import pytest

from drone_env.cli import main
from drone_env.errors import InvalidValueError
from drone_env.results.comparison import Pairing, flown_maps, paired, standings
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.interval import SCORES, interval, student, with_interval
from drone_env.results.reliable import contest, interquartile_mean, profile, shares_of_optimum

A, B = np.array([0.9, 0.5, 0.7, 0.2, 0.9]), np.array([0.6, 0.5, 0.8, 0.1, 0.1])


def pairing_of(a: np.ndarray, b: np.ndarray) -> Pairing:
    """Agents `a` and `b` with these scores; the rows are those of an evaluation, as `flown_maps` makes them."""
    flown = flown_maps("-", [run_episodes(episodes_key("easy", "greedy", range(len(a))))])
    rows = [
        row._replace(agent=agent, score=float(score))
        for agent, scores in {"a": a, "b": b}.items()
        for row, score in zip(flown, scores, strict=True)
    ]
    return paired(rows, "a", "b")


def test_the_figures_of_a_contest_by_hand() -> None:
    found = contest(pairing_of(A, B))
    assert found.maps == 5
    assert found.difference.mean == pytest.approx(0.22)
    assert found.unpaired.mean == found.difference.mean
    # Three maps won, one even, one lost.
    assert found.improvement.mean == pytest.approx(0.7)
    # Deviations 0.08, -0.22, -0.32, -0.12, 0.58; their squares add up to 0.508, divided by n - 1 = 4.
    assert found.detectable == pytest.approx(2.8 * (0.508 / 4) ** 0.5 / 5**0.5)
    assert found.narrower == pytest.approx(
        (found.unpaired.high - found.unpaired.low) / (found.difference.high - found.difference.low)
    )


@pytest.mark.parametrize(
    ("freedom", "quantile"), [(1, 12.706), (2, 4.303), (3, 3.182), (4, 2.776), (10, 2.228), (30, 2.042), (1e6, 1.960)]
)
def test_student_is_that_of_the_tables(freedom: float, quantile: float) -> None:
    assert student(freedom) == pytest.approx(quantile, rel=0.002)


def test_intervals_by_hand() -> None:
    # The squares of the deviations add up to 0.352, 0.388 and, of the differences, 0.508.
    assert interval(A, SCORES) == pytest.approx((0.64, 0.64 - 2.776 * (0.352 / 20) ** 0.5, 0.99), abs=1e-3)
    found = contest(pairing_of(A, B))
    half = 2.776 * (0.508 / 20) ** 0.5
    assert found.difference == pytest.approx((0.22, 0.22 - half, 0.22 + half), abs=1e-3)
    # Apart, there are 7.98 degrees of freedom (Welch).
    half = 2.307 * ((0.352 + 0.388) / 20) ** 0.5
    assert found.unpaired == pytest.approx((0.22, 0.22 - half, 0.22 + half), abs=1e-3)
    # Of shares, which end at 1.
    half = 2.776 * (0.8 / 20) ** 0.5
    assert found.improvement == pytest.approx((0.7, 0.7 - half, 1), abs=1e-3)


def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end() -> None:
    # The nearest of the rest replace those left out: three times 0.3, three times 0.6. There are 3 degrees of freedom.
    half = 3.182 * (0.02 * 7 / (4 * 3)) ** 0.5
    assert interquartile_mean(np.arange(1, 9) / 10) == pytest.approx((0.45, 0.45 - half, 0.45 + half), abs=1e-3)


def test_a_profile_is_the_share_of_maps_above() -> None:
    share, low, high = profile(A, np.array([0.0, 0.2, 0.7, 0.9]))
    assert share == pytest.approx([1, 0.8, 0.4, 0])
    assert (low[0], high[0], low[3], high[3]) == (1, 1, 0, 0)
    assert low[2] < 0.4 < high[2]


def test_agents_that_never_differ_have_no_ratio() -> None:
    found = contest(pairing_of(A, A))
    assert (found.difference, found.narrower, found.improvement.mean) == ((0, 0, 0), None, 0.5)


def test_who_lost_least_stands_first_whatever_the_maps_were_worth() -> None:
    flown = flown_maps("-", [run_episodes(episodes_key("easy", "greedy", range(3)))])
    by = {"best of one": [(0.6, 0.6)], "best of two": [(0.7, 0.7), (0.5, 0.5)], "rich": [(0.9, 1.0)] * 3}
    rows = [
        row._replace(agent=agent, score=score, optimum=optimum)
        for agent, maps in ({"unknown": [(1.0, None)]} | by).items()
        for row, (score, optimum) in zip(flown, maps, strict=False)
    ]
    assert [standing.agent for standing in standings(rows)] == ["best of two", "best of one", "rich", "unknown"]


def test_one_map_is_no_comparison() -> None:
    with pytest.raises(InvalidValueError, match="an interval takes two maps or more, got 1"):
        contest(pairing_of(A[:1], B[:1]))


def test_of_several_flights_over_a_map_the_mean_counts() -> None:
    key = episodes_key("easy", "random", range(20))
    repeats = [run_episodes(key._replace(repeat=repeat)) for repeat in range(3)]
    rows = flown_maps("random", repeats)
    scores = np.mean([results.scores for results in repeats], axis=0)
    assert [row.score for row in rows] == scores.tolist()
    assert {row.flights for row in rows} == {3}
    assert shares_of_optimum(rows).tolist() == (scores / repeats[0].optimal_scores).tolist()


def test_pairs_on_hard_are_at_least_four_times_as_sure(tmp_path: Path) -> None:
    file, picture = tmp_path / "figures.json", tmp_path / "profiles.svg"
    command = ["compare", "greedy", "optimal", "--task", "hard", "--episodes", "200"]
    assert main([*command, "--json", str(file), "--plot", str(picture)]) == 0
    report = json.loads(file.read_text())
    hard = report["tasks"]["hard_delivery"]
    # The same flights have the same interval wherever it is shown.
    evaluated = tmp_path / "evaluated.json"
    flown = ["--task", "hard", "--agents", "greedy", "--episodes", "200"]
    assert main(["evaluate", *flown, "--json", str(evaluated)]) == 0
    alone = json.loads(evaluated.read_text())["tasks"]["hard_delivery"]["agents"]["greedy"]
    assert list(hard["agents"]["greedy"]["score"].values()) == [alone["mean_score"], *alone["score_ci95"]]
    assert (report["split"], report["repeats"], hard["first"], list(hard["agents"])) == (
        "test",
        1,
        "greedy",
        ["greedy", "optimal"],
    )
    found = hard["others"]["optimal"]
    assert found["narrower"] >= 4
    assert found["difference"]["low"] > 0
    drawn = picture.read_text()
    assert all(name in drawn for name in ("hard", "greedy", "optimal", "share of maps"))


def test_compare_prints_its_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, command = tmp_path / "figures.json", ["compare", "random", "greedy", "pathqnet", "--seeds", "3:13"]
    assert main([*command, "--task", "easy", "skyline_easy", "--json", str(file)]) == 0
    out = capsys.readouterr().out
    for task, of_task in json.loads(file.read_text())["tasks"].items():
        for agent, figures in of_task["agents"].items():
            score = figures["score"]
            assert with_interval(score["mean"], (score["low"], score["high"])) in out, (task, agent)
        for agent, figures in of_task["others"].items():
            told = figures["difference"]
            difference = with_interval(told["mean"], (told["low"], told["high"]))
            assert f"{agent} - random {difference}" in " ".join(out.split())
            assert f"{figures['detectable']:.4f}" in out
            assert f"{figures['narrower']:.1f}" in out
    assert out.splitlines()[-1].startswith("skyline_easy, pathqnet: no network is shipped for 'skyline_easy'")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["greedy"], "compare takes two agents or more, each once; got greedy"),
        (["greedy", "greedy"], "each once; got greedy greedy"),
        (["greedy", "random", "--seeds", "3:4", "--task", "easy"], "two maps or more, got 1"),
        (["greedy", "random", "--plot", "plot.txt"], ".svg or .png; got plot.txt"),
        (["greedy", "random", "--plot", "nowhere/plot.svg"], "a folder that exists"),
        (["greedy", "random", "--repeats", "0"], "repeats must be at least 1"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compare", *arguments]) == 2
    assert told in " ".join(capsys.readouterr().err.split())
