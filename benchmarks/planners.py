"""What the planners take for a map: make bench-planners, or this file.

The values of all decisions by legs and by the exact solver, which are equal to the last bit (tests/unit/test_legs.py).
CPU time, Python included; everything is compiled before.
"""

import argparse
import platform
import time
from collections.abc import Callable, Iterable, Sequence

from drone_env.core import compiled
from drone_env.core.compile_cache import compiled_once
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TASKS
from drone_env.planning.exact import ExactSolver
from drone_env.planning.legs import Legs, LegSolver, begin_row, mark_delivered, raise_by_ways, row_of
from drone_env.planning.optimal import solve_episode
from drone_env.planning.ways import Rounds, Ways, find_ways


@compiled_once(nogil=True, **compiled.OPTIONS)
def every_cell_kernel(legs: Legs, ways: Ways, rounds: Rounds) -> None:
    """Work out the values of every cell with each set delivered, units and steps left. They are not kept."""
    spare = row_of(legs, 0, 0, 0)
    for delivered in range((1 << legs.parcels) - 1):
        done = mark_delivered(legs, delivered)
        for cell in range(legs.tables.cells):
            if legs.tables.impassable[legs.ground[cell]] or (
                0 <= legs.stop_at[cell] < legs.parcels and not delivered >> legs.stop_at[cell] & 1
            ):
                continue
            find_ways(legs.tables, legs.ground, cell, legs.most, legs.counts, legs.stop_at, ways, 0, rounds)
            for units in range(1, legs.most + 1):
                begin_row(legs, done, units, spare)
                raise_by_ways(legs, delivered, done, ways, 0, units, spare, 0, len(legs.stops))


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
        every_cell_kernel(solver.legs, solver.ways, solver.rounds)

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


def main(arguments: Sequence[str] | None = None) -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", nargs="+", default=list(TASKS))
    parser.add_argument("--maps", type=int, default=300)
    parser.add_argument("--few", type=int, default=5, help="maps for the columns that take long")
    options = parser.parse_args(arguments)
    print(f"{options.maps} test maps, {platform.platform()}, Python {platform.python_version()}")
    print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
    for task in options.task:
        print(f"| {' | '.join(row_of_task(task, options.maps, options.few))} |", flush=True)


if __name__ == "__main__":
    main()
