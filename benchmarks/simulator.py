"""How fast the batched simulator is, beside its peers.

Every round times all contenders one after another, so other load on the machine affects them alike; the median of
the rounds is printed. Then follow the memory of an episode and the time of the first step.

To time MiniGrid and EnvPool too, run it in an environment of their own:

    python -m venv .venv/bench && .venv/bench/bin/pip install -e . minigrid envpool
    .venv/bench/bin/python benchmarks/simulator.py
"""

import argparse
import os
import platform
import statistics
import subprocess
import sys
import tempfile
from typing import Any

from contenders import Contender, contenders, unit_of

from drone_env.core.batch import Batch

FIRST_STEP = """
import time
start = time.perf_counter()
import numpy as np
from drone_env.core.batch import Batch
batch = Batch("hard", 4096)
batch.reset(np.arange(4096))
batch.step(np.zeros(4096, np.int64))
print(time.perf_counter() - start)
"""


def calls_per_slice(contender: Contender, seconds: float) -> int:
    """How many calls take about this long; also warms up."""
    calls = 1
    while (took := contender.time(calls)) < seconds / 4:
        calls *= 2
    return max(1, round(calls * seconds / took))


def steps_per_second(quick: bool) -> dict[str, tuple[int, float]]:
    """For each contender: steps per call, and the median of its steps per CPU second."""
    rounds, seconds = (3, 0.05) if quick else (11, 0.25)
    entries = list(contenders(quick))
    plan = {entry.name: calls_per_slice(entry, seconds) for entry in entries}
    rates: dict[str, list[float]] = {entry.name: [] for entry in entries}
    for number in range(rounds):
        print(f"\rround {number + 1} of {rounds}", end="", file=sys.stderr, flush=True)
        for entry in entries:
            calls = plan[entry.name]
            entry.time(max(1, calls // 20))  # brings its data back into the cache
            rates[entry.name].append(calls * entry.per_call / entry.time(calls))
    print(file=sys.stderr)
    return {entry.name: (entry.per_call, statistics.median(rates[entry.name])) for entry in entries}


def first_step(folder: str) -> float:
    """Seconds from the import to the end of the first step, in a new process with this folder of compiled code."""
    environment = {**os.environ, "DRONE_ENV_CACHE": folder}
    command = [sys.executable, "-c", FIRST_STEP]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=environment)
    return float(done.stdout)


def episode_bytes(task: str, same_step: bool) -> float:
    """Bytes of the arrays of one episode in a batch."""
    batch: Any = Batch(task, 4096, same_step=same_step)
    return sum({id(array): array.nbytes for array in [*batch._buffers, batch._started]}.values()) / 4096


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer contenders, fewer and shorter rounds")
    args = parser.parse_args()
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    rates = steps_per_second(args.quick)
    print("| contender | million steps per CPU-second | ns per step | CartPole = 1 |\n|---|---|---|---|")
    for name, (num_envs, rate) in rates.items():
        ratio = f"{rate / rates[unit_of(num_envs)][1]:#.3g}" if unit_of(num_envs) in rates else ""
        print(f"| {name} | {rate / 1e6:#.4g} | {1e9 / rate:,.1f} | {ratio} |")
    sizes = (f"{episode_bytes('hard', same_step):.0f}" for same_step in (False, True))
    print("bytes of an episode of hard, NextStep and SameStep:", *sizes)
    with tempfile.TemporaryDirectory() as folder:
        cold, warm = first_step(folder), first_step(folder)
    print(f"first step: {cold:.2f} s, with compiled code in the cache {warm:.2f} s")


if __name__ == "__main__":
    main()
