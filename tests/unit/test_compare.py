"""How sure a comparison is: figures and intervals by hand, and the command."""

import numpy as np
import pytest

from drone_env.results.result import EpisodesKey, Results
from drone_env.results.statistics import (
    SCORES,
    SHARES,
    PairedComparison,
    crossed,
    interquartile_mean,
    interval,
    ranked,
    student,
)

A, B = np.array([0.9, 0.5, 0.7, 0.2, 0.9]), np.array([0.6, 0.5, 0.8, 0.1, 0.1])


def results(scores: np.ndarray, optima: np.ndarray | None = None) -> Results:
    n = len(scores)
    key = EpisodesKey("easy_delivery", 1, "custom", (0, n), "agent")
    optimal = [None] * n if optima is None else list(optima)
    return Results.of_rows(
        key, seeds=range(n), scores=list(scores), steps=[9] * n, success=[True] * n, optimal_scores=optimal
    )


def comparison(a: np.ndarray, b: np.ndarray) -> PairedComparison:
    return PairedComparison.of(results(a), results(b))


def test_the_figures_of_a_comparison_by_hand() -> None:
    paired = comparison(A, B)
    assert paired.outcomes == (3, 1, 1)
    found = paired.figures()
    assert found["maps"] == 5
    # The squares of the deviations add up to 0.352, 0.388 and, of the differences, 0.508.
    half = 2.776 * (0.508 / 20) ** 0.5
    assert list(found["difference"].values()) == pytest.approx([0.22, 0.22 - half, 0.22 + half], abs=1e-3)
    # Unpaired, there are 7.98 degrees of freedom (Welch).
    apart = 2.307 * ((0.352 + 0.388) / 20) ** 0.5
    assert list(found["unpaired"].values()) == pytest.approx([0.22, 0.22 - apart, 0.22 + apart], abs=1e-3)
    # Three maps won, one even, one lost; shares end at 1.
    half = 2.776 * (0.8 / 20) ** 0.5
    assert list(found["improvement"].values()) == pytest.approx([0.7, 0.7 - half, 1], abs=1e-3)
    assert interval(A, SCORES) == pytest.approx((0.64, 0.64 - 2.776 * (0.352 / 20) ** 0.5, 0.99), abs=1e-3)


@pytest.mark.parametrize(
    ("freedom", "quantile"), [(1, 12.706), (2, 4.303), (3, 3.182), (4, 2.776), (10, 2.228), (30, 2.042), (1e6, 1.960)]
)
def test_student_is_that_of_the_tables(freedom: float, quantile: float) -> None:
    assert student(freedom) == pytest.approx(quantile, rel=0.002)


def test_the_interquartile_mean_leaves_out_a_quarter_at_each_end() -> None:
    # The nearest of the rest replace those left out: three times 0.3, three times 0.6. There are 3 degrees of freedom.
    half = 3.182 * (0.02 * 7 / (4 * 3)) ** 0.5
    assert interquartile_mean(np.arange(1, 9) / 10) == pytest.approx((0.45, 0.45 - half, 0.45 + half), abs=1e-3)


def test_agents_that_never_differ_are_equally_good() -> None:
    found = comparison(A, A).figures()
    assert list(found["difference"].values()) == [0, 0, 0]
    assert found["improvement"]["mean"] == 0.5


def test_the_lowest_regret_ranks_first_whatever_the_maps_were_worth() -> None:
    maps = {
        "unknown": ([0.99], [np.nan]),
        "best of one": ([0.6], [0.6]),
        "best of two": ([0.7, 0.5], [0.7, 0.5]),
        "rich": ([0.9] * 3, [0.99] * 3),
    }
    agents = {agent: results(np.array(scores), np.array(optima)) for agent, (scores, optima) in maps.items()}
    assert [agent for agent, _ in ranked(agents)] == ["best of two", "best of one", "rich", "unknown"]


def test_an_interval_over_seeds_and_maps() -> None:
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(50):
        scores = 0.5 + 0.1 * rng.standard_normal((12, 1)) + 0.1 * rng.standard_normal(40)
        found = crossed(scores, SHARES)
        assert found is not None
        assert found.low < found.mean < found.high
        covered += found.low <= 0.5 <= found.high
    assert 42 <= covered <= 50
    # One seed is as certain as its maps are.
    assert crossed(scores[:1], SHARES) == pytest.approx(interval(scores[0], SHARES))
