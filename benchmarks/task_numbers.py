"""Judge the numbers of a task by what they leave to gain over its baselines.

    python benchmarks/task_numbers.py pads=2 deliveries=8,10 max_steps=50,60 --task skyline_hard

flies every combination of the values.

Prints a row per combination: the mean optimum, the CPU time of the exact solver per map, how many parcels the best
flight delivers (mean, fewest to most), on how many maps it delivers all or at most one (there is nothing to choose),
and per agent its share of the optimum, the maps on which it reaches the optimum, and its CPU time per map.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import count, product
from typing import Any

from drone_env.core.tasks import TaskConfig, get_task
from drone_env.envs.registry import register_task
from drone_env.results.evaluate import Results, evaluate

BEST = "optimal"
NUMBERS = count()


def changed(task: TaskConfig, changes: dict[str, int]) -> TaskConfig:
    """Register the task with other numbers, under a new name; without changes, the task itself."""
    if not changes:
        return task
    name = f"numbers_{next(NUMBERS)}"
    own: Any = {"id": name, "short_name": name, "grader": f"drone_env.graders:grade_{name}", **changes}
    return register_task(replace(task, **own))


def timed(agent: str, task: TaskConfig, split: str, maps: int) -> tuple[Results, float]:
    """Fly the maps; return the results and the CPU time per map in milliseconds."""
    began = time.process_time()
    results = evaluate(agent, task, split, maps)
    return results, (time.process_time() - began) / maps * 1e3


def cells_of(task: TaskConfig, agents: list[str], split: str, maps: int) -> Iterator[str]:
    """Return the cells of a row after its first."""
    for agent in (BEST, *agents):
        evaluate(agent, task, split, 2)  # compiles
    best, milliseconds = timed(BEST, task, split, maps)
    parcels, reached = best.deliveries, best.optimal_scores
    yield f"{reached.mean():.4f}"
    yield f"{milliseconds:.1f}"
    yield f"{parcels.mean():.2f} ({parcels.min()} to {parcels.max()})"
    yield f"{(parcels == task.deliveries).sum()}, {(parcels <= 1).sum()}"
    for agent in agents:
        flown, milliseconds = timed(agent, task, split, maps)
        equal = float((flown.scores == reached).mean())
        yield f"{flown.scores.mean() / reached.mean():.3f}, {equal:.0%}, {milliseconds:.2f}"


def combinations(given: list[str]) -> Iterator[dict[str, int]]:
    """Return every combination of the values of `NAME=VALUE,VALUE`."""
    pairs = [text.partition("=") for text in given]
    values = [[int(value) for value in several.split(",")] for _, _, several in pairs]
    for chosen in product(*values):
        yield {name: value for (name, _, _), value in zip(pairs, chosen, strict=True)}


def main() -> None:
    """Fly and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("numbers", nargs="*", metavar="NAME=VALUE,...", help="other values of fields of the task")
    parser.add_argument("--task", nargs="+", default=["rush_hard"])
    parser.add_argument("--agents", nargs="+", default=["greedy", "nearest"])
    parser.add_argument("--maps", type=int, default=100)
    parser.add_argument("--split", default="validation")
    options = parser.parse_args()
    head = ["task", "optimum", "ms a map", "parcels", "all, at most 1", *options.agents]
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for name, changes in product(options.task, combinations(options.numbers)):
        row = cells_of(changed(get_task(name), changes), options.agents, options.split, options.maps)
        shown = ", ".join([name, *(f"{field} {value}" for field, value in changes.items())])
        print(f"| {shown} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
