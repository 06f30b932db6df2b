"""Hashes of the maps and trajectories of the standard tasks: what must never change, on any platform or Python.

    python tests/parity/golden.py              print them, computed by plain Python
    python tests/parity/golden.py --compiled   print them, computed by the compiled functions
    python tests/parity/golden.py --write      make them the ones that the test expects

Needs NumPy alone, with `drone_env` on the path. A change of a hash means a new version of the task.

Per task there are two SHA-256 digests over the same seeds, all numbers little-endian:

- `maps`: of each map, the grid without the drone (uint8 per cell, row by row), then the cells of the start and of the
  deliveries (int16).
- `trajectories`: of each flight, after the reset and after every step up to the end, the grid (uint8), the row
  (int16), the telemetry (float32), the action mask (int8) and the score (float64); then, of each reward profile by
  name, the rewards of all steps (float64).

The actions are `pattern(seed, step)`.
"""

import argparse
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from drone_env.core import dynamics, observation
from drone_env.core.rewards import REWARD_PROFILES, interpreted_rewards, tabulate_rewards
from drone_env.core.rules import CELL, OUTCOME, PARCELS, UNDER, interpreted, row_size, tabulate
from drone_env.core.score import score
from drone_env.core.seeds import SPLITS
from drone_env.core.tasks import TASKS, TaskConfig

GOLDEN_FILE = Path(__file__).with_name("golden_v1.json")
PROFILES = ("aligned", "composite", "score", "tiered")
N_SEEDS = 1000

Hashes = dict[str, dict[str, str]]


class Backend(NamedTuple):
    """One way of running the rules."""

    tabulate: Callable[..., Any]
    tabulate_rewards: Callable[..., Any]
    buffer: Callable[..., Any]
    """Turns an array into what the functions below take."""
    reset: Callable[..., None]
    step: Callable[..., float]
    write_telemetry: Callable[..., None]
    write_action_mask: Callable[..., None]
    score: Callable[..., float]


def interpreted_backend() -> Backend:
    return Backend(
        interpreted,
        interpreted_rewards,
        memoryview,
        dynamics.reset,
        dynamics.step,
        observation.write_telemetry,
        observation.write_action_mask,
        score,
    )


def compiled_backend() -> Backend:
    import numba

    from drone_env.core import compiled

    return Backend(
        tabulate,
        tabulate_rewards,
        lambda array: array,
        compiled.reset,
        compiled.step,
        numba.njit(observation.write_telemetry),
        numba.njit(observation.write_action_mask),
        numba.njit(score),
    )


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


class Flight:
    """One episode's buffers for one backend and task."""

    def __init__(self, backend: Backend, task: TaskConfig) -> None:
        self.backend = backend
        self.rules = backend.tabulate(task)
        self.rewards = [backend.tabulate_rewards(task, REWARD_PROFILES[name]) for name in PROFILES]
        self.grid = np.zeros(self.rules.cells, np.uint8)
        self.row = np.zeros(row_size(self.rules), np.int16)
        self.telemetry = np.zeros(self.rules.telemetry_size, np.float32)
        self.mask = np.zeros(5, np.int8)
        self._buffers = [backend.buffer(array) for array in (self.grid, self.row, self.telemetry, self.mask)]

    def reset(self, seed: int) -> None:
        grid, row, _, _ = self._buffers
        self.backend.reset(self.rules, grid, row, seed)

    def map_bytes(self) -> bytes:
        grid = self.grid.copy()
        grid[self.row[CELL]] = self.row[UNDER]
        return little(grid) + little(self.row[[CELL]]) + little(self.row[PARCELS:])

    def state_bytes(self) -> bytes:
        grid, row, telemetry, mask = self._buffers
        self.backend.write_telemetry(self.rules, row, telemetry)
        self.backend.write_action_mask(self.rules, grid, row, mask)
        scored = np.array([self.backend.score(self.rules, row)], np.float64)
        return b"".join(map(little, (self.grid, self.row, self.telemetry, self.mask, scored)))

    def fly(self, seed: int, rewards: Any, digest: Any = None) -> bytes:
        """Fly map `seed` to the end and return all rewards; with a digest, hash every state on the way."""
        self.reset(seed)
        grid, row, _, _ = self._buffers
        paid: list[float] = []
        while True:
            if digest is not None:
                digest.update(self.state_bytes())
            if row[OUTCOME]:
                return little(np.array(paid, np.float64))
            paid.append(self.backend.step(self.rules, rewards, grid, row, pattern(seed, len(paid))))


def golden_hashes(backend: Backend, seeds: list[int]) -> Hashes:
    hashes = {}
    for name, task in TASKS.items():
        flight = Flight(backend, task)
        maps, trajectories = hashlib.sha256(), hashlib.sha256()
        for seed in seeds:
            flight.reset(seed)
            maps.update(flight.map_bytes())
            # The states do not depend on the rewards: hashed under the first profile only.
            first, *others = flight.rewards
            trajectories.update(flight.fly(seed, first, trajectories))
            for rewards in others:
                trajectories.update(flight.fly(seed, rewards))
        hashes[name] = {"maps": maps.hexdigest(), "trajectories": trajectories.hexdigest()}
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
