"""How sure a comparison is: figures over maps, each with its bootstrap interval (95 %, percentiles).

The figures are those of rliable (Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical
Precipice", 2021): interquartile mean, probability of improvement, performance profile. There the tasks of a benchmark
are given and runs are drawn; here maps are drawn, so that whole maps are resampled, and two agents on them together.
(The library has not been released since 2024, and needs SciPy, `arch` and seaborn for what takes a page here.)
"""

import math
from collections.abc import Callable, Mapping, Sequence
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.episodes.by_map import FlownMap
from drone_env.errors import InvalidValueError
from drone_env.evaluation.comparison import SAME, Pairing, paired
from drone_env.evaluation.statistics import RESAMPLES, Interval

Floats = npt.NDArray[np.float64]
AT_ONCE = 4_000_000
"""Numbers of one piece of a bootstrap, so that it stays within some 30 MB."""
LEAST_EFFECT = 1.96 + 0.84
"""Standard errors of a difference that a test at 5 %, two-sided, sees in 80 % of cases (Bloom, "Minimum Detectable
Effects", 1995)."""


class Contest(NamedTuple):
    """One agent beside another over the same maps, positive where the one is better."""

    maps: int
    difference: Interval
    """Mean difference in score. Its interval is of pairs: maps are drawn, and both agents fly each."""
    unpaired: Interval
    """The same with the interval that two agents over maps of their own would have."""
    narrower: float | None
    """How many times the width of the paired interval the unpaired one has; None where the pairs never differ."""
    improvement: Interval
    """The share of maps on which the one is better; where they are equal counts half."""
    detectable: float
    """The smallest true difference that as many pairs would show in four of five cases."""


def compared(flown: Mapping[str, Sequence[FlownMap]]) -> dict[str, Any]:
    """The figures of agents over the same maps, and of all others beside the first, as JSON values.

    Args:
        flown: By agent, a row for each map.

    Raises:
        InvalidValueError: if there are fewer than two maps that the first and another flew.
    """
    first, rows = next(iter(flown), None), [row for of_agent in flown.values() for row in of_agent]
    agents: dict[str, Any] = {}
    for agent, of_agent in flown.items():
        scores = np.array([row.score for row in of_agent])
        success = fmean(row.success for row in of_agent)
        agents[agent] = {
            "score": mean(scores)._asdict(),
            "iqm": interquartile_mean(scores)._asdict(),
            "success_rate": success,
        }
    others: dict[str, Any] = {}
    for agent in list(agents)[1:]:
        figures = contest(paired(rows, agent, f"{first}"))._asdict()
        others[agent] = {name: part._asdict() if isinstance(part, Interval) else part for name, part in figures.items()}
    return {"first": first, "agents": agents, "others": others}


def shares_of_optimum(rows: Sequence[FlownMap]) -> Floats:
    """Score / optimum of each map, float64[n]; the score where the optimum of one of them is not known."""
    solved = all(row.optimum is not None for row in rows)
    return np.array([row.score / (row.optimum or 1.0) if solved else row.score for row in rows])


def contest(pairing: Pairing) -> Contest:
    """How sure it is which of two agents is better.

    Raises:
        InvalidValueError: if both flew fewer than two maps.
    """
    n = pairing.maps
    if n < 2:
        raise InvalidValueError(f"a comparison takes two maps or more that both agents flew; they share {n}")
    a, b = (np.array([getattr(pair, side).score for pair in pairing.pairs]) for side in "ab")
    differences = a - b
    better = np.where(np.abs(differences) < SAME, 0.5, differences > 0)
    together = _interval(float(differences.mean()), _resample(n, lambda counts: counts @ differences / n))
    others = _resample(n, lambda counts: counts @ b / n, stream=1)
    apart = _interval(together.mean, _resample(n, lambda counts: counts @ a / n) - others)
    width = together.high - together.low
    return Contest(
        maps=n,
        difference=together,
        unpaired=apart,
        narrower=(apart.high - apart.low) / width if width > SAME else None,
        improvement=_interval(float(better.mean()), _resample(n, lambda counts: counts @ better / n)),
        detectable=LEAST_EFFECT * float(differences.std(ddof=1)) / math.sqrt(n),
    )


def mean(scores: Floats) -> Interval:
    """The mean of float64[n], one score a map."""
    n = len(scores)
    return _interval(float(scores.mean()), _resample(n, lambda counts: counts @ scores / n))


def interquartile_mean(scores: Floats) -> Interval:
    """The mean of the middle half of float64[n]: n // 4 scores are left out at each end."""
    ordered, n = np.sort(scores), len(scores)
    cut = n // 4

    def drawn(counts: npt.NDArray[np.int64]) -> Floats:
        # Of each score as many as stand between the places `cut` and `n - cut` once all that were drawn are sorted.
        ends = np.clip(counts.cumsum(axis=1), cut, n - cut)
        return np.diff(ends, axis=1, prepend=cut) @ ordered / (n - 2 * cut)

    return _interval(float(ordered[cut : n - cut].mean()), _resample(n, drawn))


def profile(scores: Floats, thresholds: Floats) -> tuple[Floats, Floats, Floats]:
    """The performance profile: of float64[n] the share above each threshold, with both ends of its interval."""
    above, n = (scores[:, None] > thresholds).astype(np.float64), len(scores)
    low, high = np.quantile(_resample(n, lambda counts: counts @ above / n), [0.025, 0.975], axis=0)
    return above.mean(axis=0), low, high


def _interval(figure: float, drawn: Floats) -> Interval:
    low, high = np.quantile(drawn, [0.025, 0.975])
    return Interval(figure, float(low), float(high))


def _resample(n: int, figure: Callable[[npt.NDArray[np.int64]], Floats], stream: int = 0) -> Floats:
    """A figure of each resample of n maps, from int64[k, n], how often each map was drawn; the same draws every time.

    Args:
        n: How many maps.
        figure: From counts to float64[k, ...].
        stream: Another one draws other maps.
    """
    rng, rows = np.random.default_rng(stream), max(1, AT_ONCE // n)
    sizes = [min(rows, RESAMPLES - done) for done in range(0, RESAMPLES, rows)]
    return np.concatenate([figure(rng.multinomial(n, np.full(n, 1 / n), size=size)) for size in sizes])
