"""Means and their 95 % intervals."""

import math
from collections.abc import Sequence
from statistics import fmean
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

RESAMPLES = 5_000


class Interval(NamedTuple):
    """A figure and its 95 % interval."""

    mean: float
    low: float
    high: float


def normal_interval(values: Sequence[float] | npt.NDArray[Any]) -> list[float] | None:
    """Mean +- 1.96 standard errors (normal approximation); None for fewer than two values."""
    if len(values) < 2:
        return None
    mean, error = fmean(values), 1.96 * float(np.std(values, ddof=1)) / math.sqrt(len(values))
    return [mean - error, mean + error]


def bootstrap(scores: npt.NDArray[np.float64], optima: npt.NDArray[np.float64] | None = None) -> Interval:
    """Mean score over seeds and maps, or its ratio to the mean optimum of the same maps, with its percentile interval.

    Seeds and maps are drawn with replacement, independently of each other, since every seed flies the same maps (Owen,
    "The pigeonhole bootstrap", 2007). With one seed the interval tells of the maps alone; with a few it is narrower
    than it should be, as every bootstrap of a few is.

    Args:
        scores: float64[seeds, maps].
        optima: float64[maps], for the ratio.
    """
    rng = np.random.default_rng(0)  # so that all draw the same maps, and settings can be compared
    n_seeds, n_maps = scores.shape
    maps = rng.multinomial(n_maps, np.full(n_maps, 1 / n_maps), size=RESAMPLES) / n_maps
    seeds = rng.multinomial(n_seeds, np.full(n_seeds, 1 / n_seeds), size=RESAMPLES) / n_seeds
    drawn = ((seeds @ scores) * maps).sum(axis=1)
    mean = float(scores.mean())
    if optima is not None:
        drawn, mean = drawn / (maps @ optima), mean / float(optima.mean())
    low, high = np.quantile(drawn, [0.025, 0.975])
    return Interval(mean, float(low), float(high))
