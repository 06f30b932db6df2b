"""What the planners take for a map; `--city FILE.toml` for the maps of a city.

The values of all decisions by legs and by the exact solver, which are equal to the last bit (tests/unit/test_legs.py).
CPU time, Python included; everything is compiled before.
"""

import argparse
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from statistics import median

from drone_env.city.city_file import read_city, task_of
from drone_env.core import compiled
from drone_env.core.cells import Cell
from drone_env.core.compile_cache import compiled_once
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS
from drone_env.errors import TooLargeError
from drone_env.planning.bounds import bounds
from drone_env.planning.legs import Legs, LegSolver, begin_row, mark_delivered, raise_by_paths, row_of
from drone_env.planning.optimal import solve_episode
from drone_env.planning.paths import find_paths
from drone_env.planning.solver import ExactSolver
from drone_env.planning.states import states_at_cells


@compiled_once(nogil=True, **compiled.OPTIONS)
def every_cell_kernel(legs: Legs) -> None:
    """Work out the values of every cell with each set delivered, units and steps left. They are not kept."""
    spare, search = row_of(legs, 0, 0, 0), legs.search
    for delivered in range((1 << legs.parcels) - 1):
        done = mark_delivered(legs, delivered)
        for cell in range(search.tables.cells):
            if search.tables.impassable[search.ground[cell]] or (
                0 <= search.stop_at[cell] < legs.parcels and not delivered >> search.stop_at[cell] & 1
            ):
                continue
            find_paths(search, cell, legs.most, 0)
            for units in range(1, legs.most + 1):
                begin_row(legs, done, units, spare)
                raise_by_paths(legs, delivered, done, 0, units, spare, 0, len(legs.stops))


def milliseconds(run: Callable[[Episode], object], episodes: Iterable[Episode]) -> float:
    """CPU time that `run` takes for an episode, on average; the first is flown once more, before."""
    first, *rest = episodes
    run(first)
    began = time.process_time()
    for episode in (first, *rest):
        run(episode)
    return (time.process_time() - began) / (1 + len(rest)) * 1e3


def row_of_task(task: str, maps: int, few: int) -> list[str]:
    """The figures of a task: `maps` maps, and `few` of them for what takes long."""
    episodes = [Episode(task, seed=seed) for seed in split_seeds("test", maps)]
    solvers = {episode.seed: LegSolver(episode) for episode in episodes}

    def every_cell(episode: Episode) -> None:
        solver = solvers[episode.seed]
        every_cell_kernel(solver.legs)

    exact = ExactSolver(episodes[0])
    return [
        task,
        f"{milliseconds(LegSolver, episodes):.2f}",
        f"{milliseconds(solve_episode, episodes):.2f}",
        f"{milliseconds(every_cell, episodes[:few]):.1f}",
        f"{milliseconds(ExactSolver, episodes[:few]):.1f}",
        f"{milliseconds(solvers[episodes[0].seed].q_values, episodes[:1] * maps) * 1e3:.0f}",
        f"{milliseconds(exact.q_values, episodes[:1] * maps) * 1e3:.0f}",
        f"{solvers[episodes[0].seed].nbytes / 1e6:.1f}",
        f"{exact.nbytes / 1e6:.1f}",
    ]


COLUMNS = (
    "task",
    "legs: all values, ms",
    "optimum and a best flight, ms",
    "legs: of every cell, ms",
    "exact: all values, ms",
    "legs: Q* of a state, us",
    "exact: Q* of a state, us",
    "legs: MB",
    "exact: MB",
)


CITY_COLUMNS = (
    "parcels",
    "pads",
    "legs: all values, s",
    "at most, s",
    "MB",
    "Q* of a state, ms",
    "Q* of every cell, s",
    "bounds, s",
    "apart by",
)


def row_of_city(file: str, parcels: int, pads: int, battery: int | None, maps: int, few: int) -> list[str]:
    """Measure a city with these numbers of parcels and pads; its own pads become roads."""
    city = read_city(file)
    grid = city.grid.copy()
    grid[grid == Cell.PAD] = Cell.ROAD
    numbers = {**city.numbers, "deliveries": parcels, "pads": pads}
    if battery is not None:
        numbers["battery_capacity"] = battery
    task = task_of(replace(city, grid=grid, parcels=(), numbers=numbers), f"city{parcels}_{pads}")
    episodes = [Episode(task, seed=seed) for seed in split_seeds("test", maps)]
    between = bounds(episodes[0])
    bounding = milliseconds(bounds, episodes[:1]) / 1e3
    bounded = [f"{bounding:.1f}", f"{between.upper - between.lower:.4f}"]
    try:
        solver = LegSolver(episodes[0])  # compiles
    except TooLargeError as error:
        print(f"{parcels} parcels, {pads} pads: {error}")
        return [str(parcels), str(pads), *"-----", *bounded]
    places = states_at_cells(episodes[0])
    one = milliseconds(solver.q_values, episodes[:1] * 20)
    whole = cpu_seconds(solver.q_values_of, places.grids, places.states)
    size = solver.nbytes / 1e6
    solver = None  # another one may take as much
    taken = [cpu_seconds(LegSolver, episode) for episode in episodes[: few if size > 300 else maps]]
    figures = (f"{median(taken):.2f}", f"{max(taken):.2f}", f"{size:.0f}", f"{one:.1f}", f"{whole:.1f}")
    return [str(parcels), str(pads), *figures, *bounded]


def cpu_seconds(run: Callable[..., object], *arguments: object) -> float:
    """CPU time of one call."""
    began = time.process_time()
    run(*arguments)
    return time.process_time() - began


def main(arguments: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", nargs="+", default=list(TASKS))
    parser.add_argument("--maps", type=int, default=300)
    parser.add_argument("--few", type=int, default=5, help="maps for the columns that take long")
    parser.add_argument("--city", metavar="FILE.toml", help="measure the maps of a city instead")
    parser.add_argument("--parcels", nargs="+", type=int, default=[5, 8, 10, 12, 16], help="of the city")
    parser.add_argument("--pads", nargs="+", type=int, default=[0, 4, 10], help="of the city")
    parser.add_argument("--battery", type=int, help="of the city; as the file says if left out")
    options = parser.parse_args(arguments)
    print(f"{options.maps} test maps, {platform.platform()}, Python {platform.python_version()}")
    if options.city:
        print(f"| {' | '.join(CITY_COLUMNS)} |\n|{'---|' * len(CITY_COLUMNS)}")
        for n in options.parcels:
            for pads in options.pads:
                row = row_of_city(options.city, n, pads, options.battery, options.maps, options.few)
                print(f"| {' | '.join(row)} |", flush=True)
        return
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for task in options.task:
        print(f"| {' | '.join(row_of_task(task, options.maps, options.few))} |", flush=True)


if __name__ == "__main__":
    main()
