"""How sure a comparison is: figures and intervals by hand."""

import numpy as np
import pytest

from drone_env.results.result import EpisodesKey, Results
from drone_env.results.statistics import (
    DIFFERENCES,
    SCORES,
    PairedComparison,
    interval,
    proportion,
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


def widened(values: list[float], within: tuple[float, float]) -> list[float]:
    """The interval with 0.9604 more values at each end of the range; 5.921 degrees of freedom for five values."""
    weights = [1.0] * len(values) + [0.9604] * 2
    n = sum(weights)
    centre = np.average([*values, *within], weights=weights)
    half = 2.4546 * (np.average((np.array([*values, *within]) - centre) ** 2, weights=weights) / (n - 1)) ** 0.5
    return [float(np.mean(values)), max(within[0], centre - half), min(within[1], centre + half)]


def test_the_figures_of_a_comparison_by_hand() -> None:
    paired = comparison(A, B)
    assert paired.outcomes == (3, 1, 1)
    found = paired.figures()
    expected = widened([0.3, 0, -0.1, 0.1, 0.8], (-0.98, 0.98))
    assert list(found["difference"].values()) == pytest.approx(expected, abs=1e-3)
    # Three maps won, one even, one lost; shares end at 1.
    assert list(found["better"].values()) == pytest.approx(widened([1, 0.5, 0, 1, 1], (0, 1)), abs=1e-3)
    assert interval(A, SCORES) == pytest.approx(widened(list(A), (0.01, 0.99)), abs=1e-3)
    # Several comparisons that hold together have wider intervals.
    assert paired.figures(3)["difference"]["low"] < found["difference"]["low"]


@pytest.mark.parametrize("n", [20, 200])
@pytest.mark.parametrize(("failures", "loss"), [(0.004, 0.9), (0.024, 0.3), (0.976, 0.9)])
def test_intervals_cover_the_truth_where_failures_are_rare(n: int, failures: float, loss: float) -> None:
    samples = np.random.default_rng(0).random((400, n)) < failures
    for within, high in (SCORES, 0.95), (DIFFERENCES, 0.0):
        found = [interval(high - loss * sample, within) for sample in samples]
        assert np.mean([low <= high - loss * failures <= upper for _, low, upper in found]) > 0.93
    shares = [proportion(sample) or [1, 0] for sample in samples]
    assert np.mean([low <= failures <= upper for low, upper in shares]) > 0.9


def test_wilson_is_that_of_the_literature() -> None:
    # Newcombe (1998), table I.
    for successes, n, low, high in ((81, 263, 0.2553, 0.3662), (0, 20, 0, 0.1611)):
        assert proportion([1] * successes + [0] * (n - successes)) == pytest.approx([low, high], abs=1e-4)
    assert proportion([1]) is None


@pytest.mark.parametrize(("freedom", "quantile"), [(1, 12.706), (2, 4.303), (3, 3.182), (30, 2.042), (10**6, 1.960)])
def test_student_is_that_of_the_tables(freedom: int, quantile: float) -> None:
    assert student(freedom) == pytest.approx(quantile, rel=0.002)


def test_the_lowest_regret_ranks_first_whatever_the_maps_were_worth() -> None:
    maps = {
        "unknown": ([0.99], [np.nan]),
        "best of one": ([0.6], [0.6]),
        "best of two": ([0.7, 0.5], [0.7, 0.5]),
        "rich": ([0.9] * 3, [0.99] * 3),
    }
    agents = {agent: results(np.array(scores), np.array(optima)) for agent, (scores, optima) in maps.items()}
    assert [agent for agent, _ in ranked(agents)] == ["best of two", "best of one", "rich", "unknown"]
