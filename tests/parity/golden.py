"""Hashes of the maps and trajectories of all tasks: what must never change, on any platform or Python.

    python tests/parity/golden.py              print them, computed by plain Python
    python tests/parity/golden.py --compiled   print them, computed by the compiled batch
    python tests/parity/golden.py --write      make them the ones that the test expects

Needs NumPy and Gymnasium, with `drone_env` on the path. A change of a hash means a new version of the task.

Per task there are its version and two SHA-256 digests over the same seeds, all numbers little-endian:

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
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.core import observation, rules
from drone_env.core.rewards import REWARD_PROFILES, interpreted_rewards
from drone_env.core.seeds import SPLITS
from drone_env.core.tables import CELL, OUTCOME, PARCELS, UNDER, interpreted, state_size
from drone_env.core.tasks import TASKS, TaskConfig

GOLDEN_FILE = Path(__file__).with_name("golden.json")
PROFILES = ("aligned", "composite", "score", "tiered")
N_SEEDS = 1000
N_FIRST = 150

Hashes = dict[str, dict[str, Any]]
Way = Callable[[TaskConfig], Callable[[list[int]], Iterator[tuple[bytes, bytes]]]]
"""Of a task, and then of seeds: the bytes of each map and of the flights over it."""


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


class Interpreted:
    """Maps and flights of one task in plain Python, as bytes."""

    def __init__(self, task: TaskConfig) -> None:
        self.task = task
        self.tables = interpreted(task)
        self.rewards = [interpreted_rewards(task, REWARD_PROFILES[name]) for name in PROFILES]
        self.grid = np.zeros(self.tables.cells, np.uint8)
        self.state = np.zeros(state_size(self.tables), np.uint16)
        self.telemetry = np.zeros(self.tables.telemetry_size, np.float32)
        self.views = memoryview(self.grid), memoryview(self.state)

    def __call__(self, seeds: list[int]) -> Iterator[tuple[bytes, bytes]]:
        for seed in seeds:
            rules.reset(self.tables, *self.views, seed)
            yield map_bytes(self.grid, self.state), self.trajectory(seed)

    def trajectory(self, seed: int) -> bytes:
        actions = [pattern(seed, step) for step in range(self.task.max_steps)]
        states = [self.observed()]
        paid = []
        for rewards in self.rewards:
            rules.reset(self.tables, *self.views, seed)
            for action in actions:
                paid.append(rules.step(self.tables, rewards, *self.views, action))
                if rewards is self.rewards[0]:
                    states.append(self.observed())
                if self.views[1][OUTCOME]:
                    break
        return b"".join([*(b"".join(column) for column in zip(*states, strict=True)), little(np.array(paid))])

    def observed(self) -> tuple[bytes, bytes, bytes, bytes]:
        observation.write_telemetry(self.tables, self.views[1], memoryview(self.telemetry))
        mask = observation.open_actions(self.tables, *self.views)
        graded = rules.score(self.tables, self.views[1])
        return self.grid.tobytes(), little(self.telemetry), mask.to_bytes(8, "little")[:5], struct.pack("<d", graded)


class Compiled:
    """The same maps and flights by the compiled batch, many seeds together."""

    def __init__(self, task: TaskConfig) -> None:
        self.task = task

    def __call__(self, seeds: list[int]) -> Iterator[tuple[bytes, bytes]]:
        # All that is seen is held in memory.
        most = max(1, 400_000 // (self.task.width * self.task.height))
        for first in range(0, len(seeds), most):
            yield from self.flown(seeds[first : first + most])

    def flown(self, seeds: list[int]) -> Iterator[tuple[bytes, bytes]]:
        from drone_env.core.batch import Batch

        n, tables = len(seeds), interpreted(self.task)
        actions = np.array([[pattern(seed, step) for seed in seeds] for step in range(self.task.max_steps)])
        logs: list[list[Any]] = [[] for _ in range(5)]
        for profile in PROFILES:
            batch = Batch(self.task, n, profile)
            batch.reset(np.array(seeds, np.int64))
            paid, ends = [], np.zeros(n, np.int64)
            for step, chosen in enumerate([*actions, None]):
                if profile == PROFILES[0]:
                    batched = batch.get_state()
                    graded = np.array([rules.score(tables, state) for state in batched["states"].tolist()])
                    masks = batch.copy_action_masks()
                    for log, array in zip(
                        logs, (batched["grids"], batched["telemetry"], masks, graded, batched["states"]), strict=True
                    ):
                        log.append(array)
                if chosen is None or ends.all():
                    break
                batch.step(chosen)
                paid.append(batch.rewards.copy())
                ends[batch.terminated & (ends == 0)] = step + 1
            logs.append(paid)
        *seen, states = (np.array(log) for log in logs[:5])
        payments = [np.array(log) for log in logs[5:]]
        for i, steps in enumerate(ends.tolist()):
            parts = [little(array[: steps + 1, i]) for array in seen]
            parts += [little(array[:steps, i]) for array in payments]
            yield map_bytes(seen[0][0, i], states[0, i]), b"".join(parts)


def map_bytes(grid: Any, state: Any) -> bytes:
    uncovered = grid.copy()
    uncovered[state[CELL]] = state[UNDER]
    return little(uncovered) + little(state[[CELL]]) + little(state[PARCELS:])


def golden_hashes(way: Way, seeds: list[int]) -> Hashes:
    hashes = {}
    for name, task in TASKS.items():
        maps, trajectories = hashlib.sha256(), hashlib.sha256()
        first: dict[str, str] = {}
        for n, (of_map, of_flight) in enumerate(way(task)(seeds), 1):
            maps.update(of_map)
            trajectories.update(of_flight)
            if n == N_FIRST:
                first = {"maps": maps.hexdigest(), "trajectories": trajectories.hexdigest()}
        hashes[name] = {
            "version": task.version,
            "maps": maps.hexdigest(),
            "trajectories": trajectories.hexdigest(),
            "first": first,
        }
    return hashes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--compiled", action="store_true", help="run the compiled batch")
    parser.add_argument("--seeds", type=int, default=N_SEEDS, help="how many seeds to hash")
    parser.add_argument("--write", action="store_true", help=f"write {GOLDEN_FILE.name}")
    arguments = parser.parse_args()
    way = Compiled if arguments.compiled else Interpreted
    text = json.dumps(golden_hashes(way, golden_seeds(arguments.seeds)), indent=2)
    if arguments.write:
        GOLDEN_FILE.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
