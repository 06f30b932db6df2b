"""How fast the batched simulator is, beside its peers.

Every round times all contenders one after another, so other load on the machine affects them alike; the median of
the rounds is printed. `--other CHECKOUT` times the `Batch` of another checkout in the same rounds, in a separate
process. Then follow the memory of an episode and the time of the first step.

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
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from contenders import Contender, contenders, unit_of

from drone_env.core.batch import Batch

ROOT = Path(__file__).resolve().parent.parent
WORKER = """
import sys
sys.path[:0] = [sys.argv[1], sys.argv[2]]  # the checkout, and the contenders
import drone_env
from pathlib import Path
if Path(drone_env.__file__).parents[1] != Path(sys.argv[1]):
    sys.exit(f"{sys.argv[1]} is not a checkout of this project: drone_env is {drone_env.__file__}")
from contenders import batches
entries = {entry.name: entry for entry in batches(sys.argv[3] == "True")}
for name, entry in entries.items():
    print(name, entry.per_call, sep="\\t")
print(flush=True)
for line in sys.stdin:
    name, calls = line.rstrip("\\n").split("\\t")
    print(entries[name].time(int(calls)), flush=True)
"""
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


class OtherContender:
    """A `Contender` of another checkout, in a process that times it."""

    def __init__(self, process: "subprocess.Popen[str]", described: str) -> None:
        self._process = process
        self._name, per_call = described.rstrip("\n").split("\t")
        self.name, self.per_call = f"{self._name}, other checkout", int(per_call)

    def time(self, calls: int) -> float:
        """CPU seconds of this many calls."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{self._name}\t{calls}\n")
        self._process.stdin.flush()
        return float(self._process.stdout.readline())


@contextmanager
def batches_of(checkout: Path | None, quick: bool) -> Generator[list[OtherContender], None, None]:
    """The batches of another checkout; none without a checkout."""
    if checkout is None:
        yield []
        return
    command = [sys.executable, "-c", WORKER, str(checkout.resolve()), str(ROOT / "benchmarks"), str(quick)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        described: list[str] = []
        while (line := process.stdout.readline()) != "\n":
            if not line:
                sys.exit(f"{checkout}: its simulator does not run")
            described.append(line)
        yield [OtherContender(process, line) for line in described]


def calls_per_slice(contender: Contender | OtherContender, seconds: float) -> int:
    """How many calls take about this long; also warms up."""
    calls = 1
    while (took := contender.time(calls)) < seconds / 4:
        calls *= 2
    return max(1, round(calls * seconds / took))


def steps_per_second(quick: bool, other: Path | None) -> dict[str, tuple[int, float]]:
    """For each contender: steps per call, and the median of its steps per CPU second."""
    rounds, seconds = (3, 0.05) if quick else (11, 0.25)
    with batches_of(other, quick) as others:
        entries: list[Contender | OtherContender] = [*contenders(quick), *others]
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
    parser.add_argument("--other", type=Path, metavar="CHECKOUT", help="time this checkout's Batch in the same rounds")
    args = parser.parse_args()
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}")
    rates = steps_per_second(args.quick, args.other)
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
