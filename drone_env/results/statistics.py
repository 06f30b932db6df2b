"""Statistics of results: means over maps, their 95 % intervals, and paired comparisons of two agents.

Flights over one map are averaged first, then the maps. `interval` is for means, `proportion` for success. Both allow
for rare failures that the maps do not show; `benchmarks/intervals.py` measures how often they cover the truth.
The share of maps on which one agent is better follows rliable (Agarwal et al., "Deep Reinforcement Learning at the Edge
of the Statistical Precipice", 2021), with maps instead of runs.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import NormalDist, fmean
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from typing_extensions import Self

from drone_env.core.rules import HIGHEST, LOWEST
from drone_env.errors import InvalidValueError
from drone_env.results.result import Results

Floats = npt.NDArray[np.float64]
Values = Sequence[float] | npt.NDArray[Any]
Bounds = list[float] | None
Range = tuple[float, float]
SCORES: Range = (LOWEST, HIGHEST)
DIFFERENCES: Range = (LOWEST - HIGHEST, HIGHEST - LOWEST)
REGRETS: Range = (0.0, HIGHEST - LOWEST)
SHARES: Range = (0.0, 1.0)
SAME = 1e-9
"""Scores that differ by less are equal: a mean of equal scores may be rounded."""


class Interval(NamedTuple):
    """A mean and its 95 % interval."""

    mean: float
    low: float
    high: float


def interval(values: Values, within: Range, comparisons: int = 1) -> Interval:
    """Return the mean of one value per map, with its interval.

    It is Student's interval after z^2 / 4 more values (0.96 for 95 %) at each end of the range. Agresti and Caffo
    (2000) add as many successes and failures to a count. So equal values have an interval too.

    Args:
        values: One value per map.
        within: The range of the values.
        comparisons: Number of intervals that hold together with 95 % (Bonferroni).

    Raises:
        InvalidValueError: if there are fewer than two maps.
    """
    if len(values) < 2:
        raise InvalidValueError(f"an interval takes two maps or more, got {len(values)}: fly more of them")
    mean, (low, high), added = fmean(values), within, _deviate(comparisons) ** 2 / 4
    n = len(values) + 2 * added
    centre = (len(values) * mean + added * (low + high)) / n
    squares = float(np.square(np.subtract(values, centre)).sum()) + added * ((low - centre) ** 2 + (high - centre) ** 2)
    half = student(n - 1, comparisons) * math.sqrt(squares / (n - 1) / n)
    return _cut(mean, centre - half, centre + half, within)


def ci95(values: Values, within: Range) -> Bounds:
    """Return both ends of `interval`; None for fewer than two maps."""
    return None if len(values) < 2 else list(interval(values, within)[1:])


def proportion(values: Values) -> Bounds:
    """Return the interval of Wilson (1927) for a share of maps; None for fewer than two maps.

    A value between 0 and 1 is a share of the flights over one map. Flights over one map count as one: they are alike.
    """
    if len(values) < 2:
        return None
    p, added = fmean(values), _deviate() ** 2 / len(values)
    half = math.sqrt(added * p * (1 - p) + added**2 / 4)
    return list(_cut(p, (p + added / 2 - half) / (1 + added), (p + added / 2 + half) / (1 + added), SHARES)[1:])


def _cut(mean: float, low: float, high: float, within: Range) -> Interval:
    """Return an interval that ends where the range does; the mean may be rounded beyond."""
    return Interval(mean, min(mean, max(low, within[0])), max(mean, min(high, within[1])))


def _deviate(comparisons: int = 1) -> float:
    return NormalDist().inv_cdf(1 - 0.025 / comparisons)


def student(freedom: float, comparisons: int = 1) -> float:
    """Return the 97.5 % quantile of Student's t, a higher one for several comparisons.

    Uses the expansion in Abramowitz and Stegun (26.7.5) above 2 degrees of freedom.
    """
    z, p = _deviate(comparisons), 0.5 - 0.025 / comparisons
    if freedom <= 2:
        return math.tan(math.pi * p) if freedom <= 1 else p * math.sqrt(8 / (1 - 4 * p**2))
    series = (
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )
    return z + math.fsum(term / freedom**power for power, term in enumerate(series, 1))


def iqm_interval(strata: Sequence[Floats], resamples: int = 50_000) -> tuple[Floats, Floats, Floats]:
    """Return interquartile means over all runs with the ends of their stratified bootstrap intervals, as rliable does.

    The means of the middle half of the values; the 2.5 % and 97.5 % quantiles over resamples of the runs of each task.
    The ends are NaN if a task has one run only.

    Args:
        strata: float64[runs, points] of each task.
        resamples: Number of resamples.
    """
    rng, (mean,) = np.random.default_rng(0), _iqm(np.concatenate(strata)[None])
    if min(map(len, strata)) < 2:
        return mean, mean * math.nan, mean * math.nan
    drawn = [runs[rng.integers(len(runs), size=(resamples, len(runs)))] for runs in strata]
    low, high = np.quantile(_iqm(np.concatenate(drawn, axis=1)), (0.025, 0.975), axis=0)
    return mean, low, high


def _iqm(values: Floats) -> Floats:
    """Return the means over runs, float64[samples, points], without the lowest and highest quarter of the runs."""
    runs = values.shape[1]
    return np.sort(values, axis=1)[:, runs // 4 : runs - runs // 4].mean(axis=1)


def mean_of(values: Values) -> float | None:
    """Return the exactly rounded mean, which does not depend on the order; None without values."""
    return fmean(values) if len(values) else None


@dataclass(frozen=True)
class Summary:
    """The statistics of results; None if unknown.

    Attributes:
        maps: Number of different maps.
        flights: Number of flights.
        score: Mean graded score.
        score_ci95: Its interval; all intervals are None for a single map.
        success_rate: Share of flights that delivered everything.
        success_ci95: Its interval.
        steps: Mean length.
        reward: Mean total reward; None if the reward profiles differ.
        optimum: Mean optimum; None if the optimum of any map is unknown.
        ratio: The optimality ratio, mean score / mean optimum.
        regret: Mean of optimum - score, over the maps with a known optimum.
        regret_ci95: Its interval.
        regret_maps: Number of these maps.
        excess_steps: Mean steps beyond the optimal flight's, over flights that delivered everything.
    """

    maps: int
    flights: int
    score: float | None
    score_ci95: Bounds
    success_rate: float | None
    success_ci95: Bounds
    steps: float | None
    reward: float | None
    optimum: float | None
    ratio: float | None
    regret: float | None
    regret_ci95: Bounds
    regret_maps: int
    excess_steps: float | None

    @classmethod
    def of(cls, results: Results) -> Self:
        """Return the statistics of results; the flights over each map are averaged first."""
        rows = results.by_map()
        assert rows.flights is not None
        # If all maps have equally many flights, the mean over flights equals the mean over maps and is rounded once.
        even = results if len(set(rows.flights.tolist())) == 1 else rows
        known = ~np.isnan(rows.optimal_scores)
        regret = (rows.optimal_scores - rows.scores)[known]
        score, optimum = mean_of(rows.scores), mean_of(rows.optimal_scores) if known.all() else None
        delivered = results.success == 1
        excess = (results.steps - results.optimal_steps)[delivered & (results.optimal_steps >= 0)]
        return cls(
            maps=len(rows.seeds),
            flights=int(rows.flights.sum()),
            score=score,
            score_ci95=ci95(rows.scores, SCORES),
            success_rate=mean_of(even.success),
            success_ci95=proportion(rows.success),
            steps=mean_of(even.steps),
            reward=None if rows.rewards is None or rows.reward_profile is None else mean_of(rows.rewards),
            optimum=optimum,
            ratio=None if score is None or optimum is None else score / optimum,
            regret=mean_of(regret),
            regret_ci95=ci95(regret, REGRETS),
            regret_maps=len(regret),
            excess_steps=mean_of(excess),
        )


def normalised(score: float | None, floor: float | None, optimum: float | None) -> float | None:
    """Return (score - floor) / (optimum - floor); `floor` is the mean score of random flights over the same maps."""
    if score is None or floor is None or optimum is None or optimum == floor:
        return None
    return (score - floor) / (optimum - floor)


def ranked(agents: Mapping[str, Results]) -> list[tuple[str, Summary]]:
    """Sort agents by mean regret, then by number of maps.

    Agents choose their own maps, and attainable scores differ by map, so only regret is comparable. Agents without a
    known optimum come last.
    """

    def rank(row: tuple[str, Summary]) -> tuple[float, int, str]:
        agent, summary = row
        return math.inf if summary.regret is None else round(summary.regret, 9), -summary.maps, agent

    return sorted(((agent, Summary.of(results)) for agent, results in agents.items()), key=rank)


@dataclass(frozen=True)
class PairedComparison:
    """Two agents over the maps that both flew.

    Attributes:
        a: The results of one agent, one row per map.
        b: The results of the other over the same maps.
    """

    a: Results
    b: Results

    @classmethod
    def of(cls, a: Results, b: Results) -> Self:
        """Pair the results of two agents by map."""
        a, b = a.by_map(), b.by_map()
        _, rows_a, rows_b = np.intersect1d(a.seeds, b.seeds, assume_unique=True, return_indices=True)
        return cls(a.take(rows_a), b.take(rows_b))

    @cached_property
    def differences(self) -> Floats:
        """Score of `a` minus score of `b`, by map."""
        return self.a.scores - self.b.scores

    @property
    def outcomes(self) -> tuple[int, int, int]:
        """Number of maps that `a` won, tied and lost."""
        wins, ties = (self.differences >= SAME).sum(), (np.abs(self.differences) < SAME).sum()
        return int(wins), int(ties), int(len(self.differences) - wins - ties)

    def figures(self, comparisons: int = 1) -> dict[str, Any]:
        """Return the statistics of the comparison as JSON values.

        `better` is the share of maps on which `a` is better; ties count half. `comparisons` intervals hold together
        with 95 %.

        Raises:
            InvalidValueError: if both flew fewer than two maps.
        """
        better = np.where(np.abs(self.differences) < SAME, 0.5, self.differences > 0)
        return {
            "difference": interval(self.differences, DIFFERENCES, comparisons)._asdict(),
            "better": interval(better, SHARES, comparisons)._asdict(),
        }
