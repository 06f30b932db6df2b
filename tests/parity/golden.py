"""Hashes of the maps and trajectories of all tasks: what must never change, on any platform or Python.

    python tests/parity/golden.py              print them, computed by plain Python
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
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.core import rules
from drone_env.core.episode import Episode
from drone_env.core.seeds import SPLITS
from drone_env.core.tables import CELL, PARCELS, UNDER, interpreted
from drone_env.core.tasks import TASKS, TaskConfig

GOLDEN_FILE = Path(__file__).with_name("golden.json")
PROFILES = ("aligned", "composite", "score", "tiered")
N_SEEDS = 1000
N_FIRST = 150

Hashes = dict[str, dict[str, Any]]
Make = Callable[[TaskConfig, int, str], Any]
"""Makes N episodes of a task under a reward profile: a `Batch`, or a `Reference` to it."""


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


class Reference:
    """Episodes flown one by one in plain Python, begun anew as `Batch` does."""

    def __init__(self, task: TaskConfig, n: int, profile: str, same_step: bool = False) -> None:
        self.episodes = [Episode(task, profile) for _ in range(n)]
        self.same_step = same_step
        self.rewards, self.terminated = np.zeros(n), np.zeros(n, np.bool_)
        self.finals: list[tuple[Any, ...]] = []

    def reset(self, seeds: Sequence[int]) -> None:
        for episode, seed in zip(self.episodes, seeds, strict=True):
            episode.reset(int(seed))

    def step(self, actions: Sequence[int]) -> None:
        self.finals = []
        for i, episode in enumerate(self.episodes):
            self.rewards[i], self.terminated[i] = 0.0, False
            if episode.ended:
                episode.reset()
                continue
            self.rewards[i] = episode.step(int(actions[i]))
            if episode.ended:
                self.terminated[i] = True
                numbers = episode.score, episode.steps, episode.deliveries_done, episode.seed
                obs = episode.observation()
                self.finals.append((i, *numbers, obs["grid"].tobytes(), obs["telemetry"].tobytes()))
                if self.same_step:
                    episode.reset()

    @property
    def seeds(self) -> npt.NDArray[np.int64]:
        return np.array([episode.seed for episode in self.episodes], np.int64)

    @property
    def action_masks(self) -> npt.NDArray[np.int8]:
        return np.array([episode.action_mask() for episode in self.episodes])

    def get_state(self) -> dict[str, npt.NDArray[Any]]:
        seen = [episode.observation() for episode in self.episodes]
        return {
            "grids": np.array([obs["grid"].ravel() for obs in seen]),
            "states": np.array([np.frombuffer(episode.get_state().numbers, np.uint16) for episode in self.episodes]),
            "telemetry": np.array([obs["telemetry"] for obs in seen]),
        }


def flown(make: Make, task: TaskConfig, seeds: list[int]) -> Iterator[tuple[bytes, bytes]]:
    """The bytes of each map and of the flights over it."""
    n, tables = len(seeds), interpreted(task)
    logs: list[list[Any]] = [[] for _ in range(5)]
    for profile in PROFILES:
        batch = make(task, n, profile)
        batch.reset(np.array(seeds, np.int64))
        paid, ends = [], np.zeros(n, np.int64)
        for step in range(task.max_steps + 1):
            if profile == PROFILES[0]:
                seen = batch.get_state()
                graded = np.array([rules.score(tables, state) for state in seen["states"].tolist()])
                arrays = seen["grids"], seen["telemetry"], batch.action_masks.copy(), graded, seen["states"]
                for log, array in zip(logs, arrays, strict=True):
                    log.append(array)
            if ends.all():
                break
            batch.step(np.array([pattern(seed, step) for seed in seeds]))
            paid.append(batch.rewards.copy())
            ends[batch.terminated & (ends == 0)] = step + 1
        logs.append(paid)
    *columns, states = (np.array(log) for log in logs[:5])
    payments = [np.array(log) for log in logs[5:]]
    for i, steps in enumerate(ends.tolist()):
        parts = [little(array[: steps + 1, i]) for array in columns]
        parts += [little(array[:steps, i]) for array in payments]
        yield map_bytes(columns[0][0, i], states[0, i]), b"".join(parts)


def map_bytes(grid: Any, state: Any) -> bytes:
    uncovered = grid.copy()
    uncovered[state[CELL]] = state[UNDER]
    return little(uncovered) + little(state[[CELL]]) + little(state[PARCELS:])


def digests(maps: Any, trajectories: Any) -> dict[str, str]:
    return {"maps": maps.hexdigest(), "trajectories": trajectories.hexdigest()}


def golden_hashes(make: Make, seeds: list[int], at_once: int, tasks: Mapping[str, TaskConfig] = TASKS) -> Hashes:
    """The hashes, of so many cells at once: everything that is seen is held in memory."""
    hashes = {}
    for name, task in tasks.items():
        maps, trajectories = hashlib.sha256(), hashlib.sha256()
        first: dict[str, str] = {}
        most = max(1, at_once // (task.width * task.height))
        parts = (flown(make, task, seeds[i : i + most]) for i in range(0, len(seeds), most))
        for n, (of_map, of_flight) in enumerate(chain.from_iterable(parts), 1):
            maps.update(of_map)
            trajectories.update(of_flight)
            if n == N_FIRST:
                first = digests(maps, trajectories)
        hashes[name] = {"version": task.version, **digests(maps, trajectories), "first": first}
    return hashes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=N_SEEDS, help="how many seeds to hash")
    parser.add_argument("--write", action="store_true", help=f"write {GOLDEN_FILE.name}")
    arguments = parser.parse_args()
    text = json.dumps(golden_hashes(Reference, golden_seeds(arguments.seeds), at_once=1), indent=2)
    if arguments.write:
        GOLDEN_FILE.write_text(text + "\n", encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
