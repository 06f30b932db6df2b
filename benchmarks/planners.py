"""CPU time of the planners per map; `--city FILE.toml` for the maps of a city.

The leg solver and the exact solver compute the values of all decisions, equal to the last bit
(tests/unit/test_legs.py). Python is included; everything is compiled before.
"""

import argparse
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from statistics import median

from drone_env.city.city_file import read_city, task_of
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS
from drone_env.planning.legs import LegSolver
from drone_env.planning.optimal import solve_episode
from drone_env.planning.solver import ExactSolver

COLUMNS = (
    "task",
    "legs: all values, ms",
    "optimum and a best flight, ms",
    "exact: all values, ms",
    "legs: Q* of a state, us",
    "legs: MB",
    "exact: MB",
)
CITY_COLUMNS = ("parcels", "pads", "legs: all values, s", "at most, s", "MB")


def cpu_seconds(run: Callable[[Episode], object], episodes: Sequence[Episode]) -> list[float]:
    """CPU time of each run, without the first, which compiles and is repeated."""
    times: list[float] = []
    for episode in (episodes[0], *episodes):
        began = time.process_time()
        run(episode)
        times.append(time.process_time() - began)
    return times[1:]


def bytes_of(solver: LegSolver) -> int:
    """Memory of the values and paths in bytes."""
    return solver.legs.ranks.nbytes + sum(array.nbytes for array in solver.legs.search.paths)


def row_of_task(task: str, maps: int, few: int) -> list[str]:
    """Measure a task on `maps` maps, and the exact solver on `few` of them."""
    episodes = [Episode(task, seed=seed) for seed in split_seeds("test", maps)]
    legs, exact = LegSolver(episodes[0]), ExactSolver(episodes[0])

    def milliseconds(run: Callable[[Episode], object], flown: Sequence[Episode]) -> float:
        times = cpu_seconds(run, flown)
        return 1e3 * sum(times) / len(times)

    return [
        task,
        f"{milliseconds(LegSolver, episodes):.2f}",
        f"{milliseconds(solve_episode, episodes):.2f}",
        f"{milliseconds(ExactSolver, episodes[:few]):.1f}",
        f"{milliseconds(legs.q_values, episodes[:1] * maps) * 1e3:.0f}",
        f"{bytes_of(legs) / 1e6:.1f}",
        f"{exact.returns.values.nbytes / 1e6:.1f}",
    ]


def row_of_city(file: str, parcels: int, pads: int, maps: int) -> list[str]:
    """Measure a city with these numbers of parcels and pads; its own pads become roads."""
    city = read_city(file)
    grid = city.grid.copy()
    grid[grid == Cell.PAD] = Cell.ROAD
    numbers = {**city.numbers, "deliveries": parcels, "pads": pads}
    task = task_of(replace(city, grid=grid, parcels=(), numbers=numbers), f"city{parcels}_{pads}")
    episodes = [Episode(task, seed=seed) for seed in split_seeds("test", maps)]
    times = cpu_seconds(LegSolver, episodes)
    return [
        str(parcels),
        str(pads),
        f"{median(times):.2f}",
        f"{max(times):.2f}",
        f"{bytes_of(LegSolver(episodes[0])) / 1e6:.0f}",
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", nargs="+", default=list(TASKS))
    parser.add_argument("--maps", type=int, default=300)
    parser.add_argument("--few", type=int, default=5, help="maps for the exact solver")
    parser.add_argument("--city", metavar="FILE.toml", help="measure the maps of a city instead")
    parser.add_argument("--parcels", nargs="+", type=int, default=[5], help="of the city")
    parser.add_argument("--pads", nargs="+", type=int, default=[0, 10, 50], help="of the city")
    options = parser.parse_args()
    print(f"{options.maps} test maps, {platform.platform()}, Python {platform.python_version()}")
    columns = CITY_COLUMNS if options.city else COLUMNS
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    if options.city:
        rows = (row_of_city(options.city, n, pads, options.maps) for n in options.parcels for pads in options.pads)
    else:
        rows = (row_of_task(task, options.maps, options.few) for task in options.task)
    for row in rows:
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
