"""Hashes of the maps and trajectories of the standard tasks: what must never change, on any platform or Python.

    python tests/parity/golden.py              print them, computed by plain Python
    python tests/parity/golden.py --compiled   print them, computed by the compiled functions
    python tests/parity/golden.py --write      make them the ones that the test expects

Needs NumPy and Gymnasium, with `drone_env` on the path. A change of a hash means a new version of the task.

Per task there are two SHA-256 digests over the same seeds, all numbers little-endian:

- `maps`: of each map, the grid without the drone (uint8 per cell, row by row), then the cells of the start and of the
  deliveries (uint16).
- `trajectories`: of each flight, as they stand after the reset and after every step up to the end, all grids (uint8),
  all telemetry (float32), all action masks (int8) and all scores (float64); then, under each reward
  profile in the order of their names, the rewards of all steps (float64).

The actions are `pattern(seed, step)`. `first` has the same two digests over the first seeds alone, which is what other
processes and other Pythons are asked for where there is little time.
"""

import argparse
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core import dynamics, observation, score
from drone_env.core.rewards import REWARD_PROFILES, interpreted_rewards, tabulate_rewards
from drone_env.core.rules import CELL, OUTCOME, PARCELS, UNDER, interpreted, row_size, tabulate
from drone_env.core.seeds import SPLITS
from drone_env.core.tasks import TASKS, TaskConfig

GOLDEN_FILE = Path(__file__).with_name("golden_v1.json")
PROFILES = ("aligned", "composite", "score", "tiered")
N_SEEDS = 1000
N_FIRST = 150

Hashes = dict[str, dict[str, Any]]


class Backend(NamedTuple):
    """One way of running the rules."""

    tabulate: Callable[..., Any]
    tabulate_rewards: Callable[..., Any]
    buffer: Callable[..., Any]
    """Turns an array into what the functions below take."""
    reset: Callable[..., None]
    fly_logging: Callable[..., int]
    fly: Callable[..., int]


def interpreted_backend() -> Backend:
    fly_logging, fly = make_flights(dynamics.step, observation.write_telemetry, observation.open_actions, score.score)
    return Backend(interpreted, interpreted_rewards, memoryview, dynamics.reset, fly_logging, fly)


def compiled_backend() -> Backend:
    from numba import njit

    from drone_env.core import compiled

    fly_logging, fly = make_flights(
        compiled.step, njit(observation.write_telemetry), njit(observation.open_actions), njit(score.score)
    )
    return Backend(tabulate, tabulate_rewards, lambda array: array, compiled.reset, njit(fly_logging), njit(fly))


def make_flights(
    step: Callable[..., float],
    write_telemetry: Callable[..., None],
    open_actions: Callable[..., int],
    score: Callable[..., float],
) -> tuple[Callable[..., int], Callable[..., int]]:
    """Two functions that fly to the end and return the number of steps: one logs every state, the other none."""

    def fly_logging(
        rules: Any, rewards: Any, grid: Any, row: Any, actions: Any, paid: Any,
        grids: Any, telemetry: Any, masks: Any, scores: Any,
    ) -> int:  # fmt: skip
        n = 0
        while True:
            grids[n] = grid
            write_telemetry(rules, row, telemetry[n])
            mask = open_actions(rules, grid, row)
            for action in range(5):
                masks[n, action] = mask >> 8 * action & 1
            scores[n] = score(rules, row)
            if row[OUTCOME] != 0:
                return n
            paid[n] = step(rules, rewards, grid, row, actions[n])
            n += 1

    def fly(rules: Any, rewards: Any, grid: Any, row: Any, actions: Any, paid: Any) -> int:
        n = 0
        while row[OUTCOME] == 0:
            paid[n] = step(rules, rewards, grid, row, actions[n])
            n += 1
        return n

    return fly_logging, fly


def golden_seeds(count: int) -> list[int]:
    """The first seeds of the three splits in turn: train, validation, test, train, ..."""
    splits = list(SPLITS.values())
    return [splits[i % 3].start + i // 3 for i in range(count)]


def pattern(seed: int, step: int) -> int:
    """The action at `step`: zigzag in legs of three to the lower right for 25 steps, to the upper left for the next 25.

    About every seventh step waits. Which of the two comes first, and which way a leg goes, depends on the seed.
    """
    if (seed + step * step) % 7 == 3:
        return 4
    across = (seed // 2 + step // 3) % 2
    back = (seed // 3 + step // 25) % 2
    return 2 * across + 1 - back


def little(array: npt.NDArray[Any]) -> bytes:
    return array.astype(array.dtype.newbyteorder("<"), copy=False).tobytes()


class Flights:
    """Maps and flights of one task under one backend, as bytes."""

    def __init__(self, backend: Backend, task: TaskConfig) -> None:
        self.backend = backend
        self.rules = backend.tabulate(task)
        self.rewards = [backend.tabulate_rewards(task, REWARD_PROFILES[name]) for name in PROFILES]
        self.grid = np.zeros(self.rules.cells, np.uint8)
        self.row = np.zeros(row_size(self.rules), np.uint16)
        states = task.max_steps + 1
        self.actions = np.zeros(states, np.int64)
        self.paid = np.zeros(states, np.float64)
        self.log = (
            np.zeros((states, self.grid.size), np.uint8),
            np.zeros((states, self.rules.telemetry_size), np.float32),
            np.zeros((states, 5), np.int8),
            np.zeros(states, np.float64),
        )
        self.buffers = [backend.buffer(array) for array in (self.grid, self.row, self.actions, self.paid)]

    def reset(self, seed: int) -> None:
        self.backend.reset(self.rules, self.buffers[0], self.buffers[1], seed)

    def map_bytes(self, seed: int) -> bytes:
        self.reset(seed)
        self.grid[self.row[CELL]] = self.row[UNDER]
        return little(self.grid) + little(self.row[[CELL]]) + little(self.row[PARCELS:])

    def trajectory_bytes(self, seed: int) -> bytes:
        self.actions[:] = [pattern(seed, step) for step in range(len(self.actions))]
        first, *others = self.rewards
        self.reset(seed)
        steps = self.backend.fly_logging(self.rules, first, *self.buffers, *self.log)
        parts = [little(array[: steps + 1]) for array in self.log]
        parts.append(little(self.paid[:steps]))
        for rewards in others:
            self.reset(seed)
            steps = self.backend.fly(self.rules, rewards, *self.buffers)
            parts.append(little(self.paid[:steps]))
        return b"".join(parts)


def golden_hashes(backend: Backend, seeds: list[int]) -> Hashes:
    hashes = {}
    for name, task in TASKS.items():
        flights = Flights(backend, task)
        maps, trajectories = hashlib.sha256(), hashlib.sha256()
        first: dict[str, str] = {}
        for n, seed in enumerate(seeds, 1):
            maps.update(flights.map_bytes(seed))
            trajectories.update(flights.trajectory_bytes(seed))
            if n == N_FIRST:
                first = {"maps": maps.hexdigest(), "trajectories": trajectories.hexdigest()}
        hashes[name] = {"maps": maps.hexdigest(), "trajectories": trajectories.hexdigest(), "first": first}
    return hashes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--compiled", action="store_true", help="run the compiled functions")
    parser.add_argument("--seeds", type=int, default=N_SEEDS, help="how many seeds to hash")
    parser.add_argument("--write", action="store_true", help=f"write {GOLDEN_FILE.name}")
    arguments = parser.parse_args()
    backend = compiled_backend() if arguments.compiled else interpreted_backend()
    text = json.dumps(golden_hashes(backend, golden_seeds(arguments.seeds)), indent=2)
    if arguments.write:
        GOLDEN_FILE.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
