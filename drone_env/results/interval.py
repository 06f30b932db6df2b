"""The interval (95 %) behind every mean: Student's t over maps, cut to the range that the figure can have."""

import math
from collections.abc import Sequence
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core.rules import HIGHEST, LOWEST
from drone_env.errors import InvalidValueError

Values = Sequence[float] | npt.NDArray[Any]
Range = tuple[float, float]
SCORES: Range = (LOWEST, HIGHEST)
DIFFERENCES: Range = (LOWEST - HIGHEST, HIGHEST - LOWEST)
REGRETS: Range = (0.0, HIGHEST - LOWEST)
SHARES: Range = (0.0, 1.0)


class Interval(NamedTuple):
    """A figure and its 95 % interval."""

    mean: float
    low: float
    high: float


def interval(values: Values, within: Range) -> Interval:
    """The mean of one value a map, with its interval.

    Raises:
        InvalidValueError: if there are fewer than two maps.
    """
    if len(values) < 2:
        raise InvalidValueError(f"an interval takes two maps or more, got {len(values)}: fly more of them")
    return of_errors(fmean(values), [error_of(values)], within)


def ci95(values: Values, within: Range) -> list[float] | None:
    """Both ends of `interval`; None for fewer than two maps."""
    return None if len(values) < 2 else list(interval(values, within)[1:])


def crossed(scores: npt.NDArray[np.float64], within: Range) -> Interval | None:
    """The mean of float64[seeds, maps], where every seed flies the same maps, with its interval; None for one map.

    The variances of the means by seed and by map add up. With one seed the interval covers the maps alone.
    """
    if scores.shape[1] < 2:
        return None
    means = [scores.mean(axis=0), scores.mean(axis=1)]
    return of_errors(float(scores.mean()), [error_of(of) for of in means if len(of) > 1], within)


def error_of(values: Values) -> tuple[float, int]:
    """The variance of the mean of independent values, and its degrees of freedom."""
    return float(np.var(values, ddof=1)) / len(values), len(values) - 1


def of_errors(mean: float, errors: Sequence[tuple[float, int]], within: Range) -> Interval:
    """Build the interval of a figure with independent errors (Welch and Satterthwaite).

    Args:
        mean: The figure.
        errors: The variance that each adds to it, and the degrees of freedom of that.
        within: The range of the figure.
    """
    variance = math.fsum(error for error, _ in errors)
    if variance == 0:
        return Interval(mean, mean, mean)
    freedom = variance**2 / math.fsum(error**2 / degrees for error, degrees in errors)
    half = student(freedom) * math.sqrt(variance)
    low, high = within
    return Interval(mean, max(low, mean - half), min(high, mean + half))


def student(freedom: float) -> float:
    """The 97.5 % quantile of Student's t, to 0.2 %.

    From 3 degrees of freedom on by the expansion in Abramowitz and Stegun (26.7.5); below that, of whole degrees.
    """
    if freedom < 3:
        return 12.7062 if round(freedom, 9) < 2 else 4.3027
    z = 1.959964
    series = (
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )
    return z + sum(term / freedom**power for power, term in enumerate(series, 1))


def with_interval(mean: float | None, interval: Sequence[float] | None, form: str = ".4f") -> str:
    """Write a mean with half the width of its interval; with both ends if the range of the figure cuts one off."""
    if mean is None or interval is None:
        return "-" if mean is None else format(mean, form)
    low, high = interval
    if abs(low + high - 2 * mean) > 1e-9:
        return f"{mean:{form}} [{low:{form}}, {high:{form}}]"
    return f"{mean:{form}} ± {high - mean:{form}}"
