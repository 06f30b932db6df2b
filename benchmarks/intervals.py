"""Coverage and mean width of 95 % intervals, on samples of real flights.

python benchmarks/intervals.py                       # the numbers of docs/quoting.md, 4 minutes
python benchmarks/intervals.py --tasks easy hard --sizes 10 50

The flights over the first validation maps are the population; its mean is the truth. A row is a mean of scores, a
paired difference or a success rate. A cell contains coverage and mean width over samples of n maps.
"""

import argparse
import math
from collections.abc import Callable, Iterator

import numpy as np
import numpy.typing as npt

from drone_env.results.evaluate import evaluate
from drone_env.results.statistics import DIFFERENCES, SCORES, SHARES, Range, interval, proportion, student

Floats = npt.NDArray[np.float64]
Ends = tuple[float, float]
AGENTS = "random", "greedy", "tournet", "optimal"
LOST = 0.9
"""Share of the flights of a language model whose answers are all unusable; it flies the others like greedy."""


def student_t(x: Floats, within: Range) -> Ends:
    """Student's t, cut to the range."""
    half = student(len(x) - 1) * float(x.std(ddof=1)) / math.sqrt(len(x))
    return max(within[0], float(x.mean()) - half), min(within[1], float(x.mean()) + half)


def ours(x: Floats, within: Range) -> Ends:
    """The package's interval: Wilson for success, else Student's t with values added at the ends of the range."""
    low, high = proportion(x) or SHARES if within is SHARES else interval(x, within)[1:]
    return low, high


METHODS: dict[str, Callable[[Floats, Range], Ends]] = {
    "Student's t": student_t,
    "the package": ours,
}


def populations(tasks: list[str], maps: int) -> Iterator[tuple[str, Floats, Range]]:
    """Yield name, one value per map and range of each row."""
    for task in tasks:
        flown = {agent: evaluate(agent, task, "validation", maps) for agent in AGENTS}
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
