"""Coverage and mean width of 95 % intervals, on samples of real flights.

python benchmarks/intervals.py                       # the numbers of docs/quoting.md, 4 minutes
python benchmarks/intervals.py --tasks easy hard --sizes 10 50

The flights over the first validation maps are the population; its mean is the truth. A row is a mean of scores, a
paired difference or a success rate. A cell contains coverage and mean width over samples of n maps.
"""

import argparse
import math
from collections.abc import Callable, Iterator
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from drone_env.core.seeds import split_seeds
from drone_env.results.evaluate import episodes_key, run_episodes
from drone_env.results.statistics import DIFFERENCES, SCORES, SHARES, Range, interval, proportion, student

Floats = npt.NDArray[np.float64]
Ends = tuple[float, float]
AGENTS = "random", "greedy", "tournet", "optimal"
NORMAL = NormalDist()
LOST = 0.9
"""Share of the flights of a language model whose answers are all unusable; it flies the others like greedy."""


def student_t(x: Floats, within: Range) -> Ends:
    """Student's t, cut to the range."""
    half = student(len(x) - 1) * float(x.std(ddof=1)) / math.sqrt(len(x))
    return max(within[0], float(x.mean()) - half), min(within[1], float(x.mean()) + half)


def betting(x: Floats, within: Range) -> Ends:
    """Hedged capital with bets for a fixed n (Waudby-Smith and Ramdas 2024)."""

    def lower(y: Floats) -> float:
        n, rich = len(y), math.log(2 / 0.05)
        mean = (0.5 + np.cumsum(y)) / np.arange(2, n + 2)
        variance = (0.25 + np.cumsum((y - mean) ** 2)) / np.arange(2, n + 2)
        bets = np.sqrt(2 * rich / (n * np.append(0.25, variance[:-1])))
        low, high = 0.0, 1.0
        for _ in range(20):
            middle = (low + high) / 2
            lost = np.log1p(np.minimum(bets, 0.75 / middle) * (y - middle)).sum() >= rich
            low, high = (middle, high) if lost else (low, middle)
        return low

    size = within[1] - within[0]
    y = (x - within[0]) / size
    return within[0] + size * lower(y), within[1] - size * lower(1 - y)


def bca(x: Floats, within: Range) -> Ends:
    """The bootstrap with bias correction and acceleration (Efron 1987), 300 resamples."""
    drawn = x[np.random.default_rng(0).integers(len(x), size=(300, len(x)))].mean(axis=1)
    d, less = x - x.mean(), ((drawn < x.mean()).mean() + (drawn <= x.mean()).mean()) / 2
    bias = NORMAL.inv_cdf(min(max(float(less), 1e-3), 1 - 1e-3))
    pull = float((d**3).sum() / (6 * (d @ d) ** 1.5)) if d.any() else 0.0
    ends = [bias + z for z in (NORMAL.inv_cdf(0.025), NORMAL.inv_cdf(0.975))]
    low, high = np.quantile(drawn, [NORMAL.cdf(bias + end / (1 - pull * end)) for end in ends])
    return float(low), float(high)


def ours(x: Floats, within: Range) -> Ends:
    """That of the package: Wilson for success, else Student's t with values added at the ends of the range."""
    low, high = proportion(x) or SHARES if within is SHARES else interval(x, within)[1:]
    return low, high


METHODS: dict[str, Callable[[Floats, Range], Ends]] = {
    "Student's t": student_t,
    "BCa": bca,
    "betting": betting,
    "the package": ours,
}


def populations(tasks: list[str], maps: int) -> Iterator[tuple[str, Floats, Range]]:
    """Yield name, one value per map and range of each row."""
    for task in tasks:
        keys = [episodes_key(task, agent, split_seeds("validation", maps), "validation") for agent in AGENTS]
        flown = {key.agent: run_episodes(key) for key in keys}
        scores = {agent: results.scores for agent, results in flown.items()}
        lost = np.random.default_rng(0).random(maps) < LOST
        scores["model"] = np.where(lost, SCORES[0], scores["greedy"])
        for agent in scores:
            yield f"{task}: {agent}", scores[agent], SCORES
        for a, b in (("optimal", "tournet"), ("tournet", "greedy"), ("greedy", "random"), ("greedy", "model")):
            yield f"{task}: {a} - {b}", scores[a] - scores[b], DIFFERENCES
        for agent in ("tournet", "greedy"):
            yield f"{task}: success of {agent}", flown[agent].success.astype(float), SHARES


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=["skyline_easy"])
    parser.add_argument("--sizes", nargs="+", type=int, default=[20, 200, 1000])
    parser.add_argument("--maps", type=int, default=5000)
    parser.add_argument("--samples", type=int, default=500)
    given = parser.parse_args()
    print(f"| | n | {' | '.join(METHODS)} |\n|{'---|' * (len(METHODS) + 2)}")
    for name, values, within in populations(given.tasks, given.maps):
        for n in given.sizes:
            drawn = values[np.random.default_rng(n).integers(len(values), size=(given.samples, n))]
            cells: list[str] = []
            for method in METHODS.values():
                low, high = np.array([method(sample, within) for sample in drawn]).T
                covered = (low <= values.mean() + 1e-9) & (values.mean() - 1e-9 <= high)
                cells.append(f"{covered.mean():.1%} {(high - low).mean():.4f}")
            print(f"| {name} | {n} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
