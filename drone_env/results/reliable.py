"""How sure a comparison is: figures over maps, each with its interval (95 %, `statistics`).

The figures are those of rliable (Agarwal et al., "Deep Reinforcement Learning at the Edge of the Statistical
Precipice", 2021): interquartile mean, probability of improvement, performance profile. rliable draws runs of
given tasks; we draw maps, and two agents fly the same ones.
"""

import math
from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.results.by_map import FlownMap
from drone_env.results.comparison import SAME, Pairing, paired
from drone_env.results.interval import DIFFERENCES, SCORES, SHARES, Interval, error_of, interval, of_errors

Floats = npt.NDArray[np.float64]
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
            "score": interval(scores, SCORES)._asdict(),
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
    a, b = (np.array([getattr(pair, side).score for pair in pairing.pairs]) for side in "ab")
    differences = a - b
    together = interval(differences, DIFFERENCES)
    apart = of_errors(together.mean, [error_of(a), error_of(b)], DIFFERENCES)
    better = np.where(np.abs(differences) < SAME, 0.5, differences > 0)
    width = together.high - together.low
    return Contest(
        maps=pairing.maps,
        difference=together,
        unpaired=apart,
        narrower=(apart.high - apart.low) / width if width > SAME else None,
        improvement=interval(better, SHARES),
        detectable=LEAST_EFFECT * math.sqrt(error_of(differences)[0]),
    )


def interquartile_mean(scores: Floats) -> Interval:
    """The mean of the middle half of float64[n]: n // 4 scores are left out at each end.

    The interval is the one of Tukey and McLaughlin (1963) for a trimmed mean: its variance comes from all scores, with
    each that is left out replaced by the nearest that is not.
    """
    ordered, n = np.sort(scores), len(scores)
    cut = n // 4
    middle = ordered[cut : n - cut]
    winsorised, _ = error_of(np.clip(ordered, middle[0], middle[-1]))
    freedom = len(middle) - 1
    error = winsorised * n * (n - 1) / (len(middle) * freedom)
    return of_errors(fmean(middle), [(error, freedom)], SCORES)


def profile(scores: Floats, thresholds: Floats) -> tuple[Floats, Floats, Floats]:
    """The performance profile: of float64[n] the share above each threshold, with both ends of its interval."""
    share, low, high = np.array([interval(scores > threshold, SHARES) for threshold in thresholds]).T
    return share, low, high
