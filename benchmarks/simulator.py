"""How fast the batched simulator is, beside its peers and the machine's limits.

Vector environments are compared with Gymnasium's CartPole at the same number of episodes. `--other CHECKOUT` times the
`Batch` of another checkout in the same rounds, in a separate process.

It creates the virtual environment `.venv/bench` with this project and its peers, and runs itself there. All
contenders are timed in turn, round by round, so that whatever else runs on the machine meets all of them alike; the
median of the rounds is printed.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from contenders import Contender

ROOT = Path(__file__).resolve().parent.parent
HOME = ROOT / ".venv" / "bench"
PYTHON = HOME / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
READY = HOME / "ready.json"

OTHER = ", other checkout"
WORKER = """
import sys
sys.path[:0] = [sys.argv[1], sys.argv[2]]  # the checkout, and the contenders
import drone_env
from pathlib import Path
if Path(drone_env.__file__).parents[1] != Path(sys.argv[1]):
    sys.exit(f"{sys.argv[1]} is no checkout of this project: drone_env was found at {drone_env.__file__}")
from contenders import batches
entries = {entry.name: entry for entry in batches(sys.argv[3] == "True")}
for name, entry in entries.items():
    print(name, entry.per_call, entry.observation, sep="\\t")
print(flush=True)
for line in sys.stdin:
    name, calls = line.rstrip("\\n").split("\\t")
    print(*entries[name].time(int(calls)), flush=True)
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
MEMORY = """
import os, sys
import numpy as np
from drone_env.core.batch import Batch
def resident():
    return int(open("/proc/self/statm").read().split()[1]) * os.sysconf("SC_PAGE_SIZE") if os.name == "posix" else 0
task, num_envs, same_step = sys.argv[1], int(sys.argv[2]), sys.argv[3] == "True"
Batch(task, 1, same_step=same_step)
actions = np.zeros(num_envs, np.int64) + 4
before = resident()
batch = Batch(task, num_envs, same_step=same_step)
arrays = {id(array): array.nbytes for array in [*batch._buffers, batch._started]}
print(sum(arrays.values()))
if sys.platform == "linux":
    batch.reset(np.arange(num_envs))
    batch.step(actions)
    print(resident() - before)
"""


def prepare() -> None:
    """Make the environment, unless it is there and newer than the project's requirements."""
    if READY.exists() and READY.stat().st_mtime > (ROOT / "pyproject.toml").stat().st_mtime:
        return
    print(f"making {HOME} with this project, MiniGrid and EnvPool ...", file=sys.stderr)
    subprocess.run([sys.executable, "-m", "venv", str(HOME)], check=True)
    install = [str(PYTHON), "-m", "pip", "install", "-qq", "--disable-pip-version-check"]
    subprocess.run([*install, "--editable", str(ROOT), "minigrid"], check=True)
    tried = subprocess.run([*install, "--only-binary", "envpool", "envpool"], capture_output=True, text=True)
    reason = None
    if tried.returncode:
        reason = next((line for line in tried.stderr.splitlines() if line.startswith("ERROR")), "pip failed")
    else:
        tried = subprocess.run([str(PYTHON), "-c", "import envpool"], capture_output=True, text=True)
        if tried.returncode:
            reason = tried.stderr.strip().splitlines()[-1]
    READY.write_text(json.dumps({"envpool": reason}))


def machine() -> dict[str, str]:
    """What the figures were measured on."""
    model = platform.processor() or platform.machine()
    described = Path("/proc/cpuinfo")
    if described.exists():
        lines = [line.split(":", 1)[1].strip() for line in described.read_text().splitlines() if "model name" in line]
        model = lines[0] if lines else model
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    facts = {"cpu": model, "cores": str(cores), "system": platform.system(), "python": platform.python_version()}
    for package in ("numpy", "numba", "gymnasium", "minigrid", "envpool"):
        try:
            facts[package] = version(package)
        except PackageNotFoundError:
            facts[package] = "absent"
    return facts


class Elsewhere:
    """A contender of another checkout, in a process that times it when asked; otherwise like a `Contender`."""

    unit = "steps"

    def __init__(self, process: "subprocess.Popen[str]", described: str) -> None:
        self._process = process
        self._name, per_call, observation = described.rstrip("\n").split("\t")
        self.name = self._name + OTHER
        self.per_call = int(per_call)
        self.observation = float(observation)

    def time(self, calls: int) -> tuple[float, float]:
        """Make this many calls: seconds of CPU time, and of the clock."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{self._name}\t{calls}\n")
        self._process.stdin.flush()
        cpu, wall = self._process.stdout.readline().split()
        return float(cpu), float(wall)


@contextmanager
def batches_of(checkout: Path | None, quick: bool) -> Generator[list[Elsewhere], None, None]:
    """The batches of another checkout, ready to be timed; none where none is named."""
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
        yield [Elsewhere(process, line) for line in described]


def unit_of(num_envs: int) -> str:
    """The CartPole of as many episodes, to compare with."""
    return "CartPole-v1 1" if num_envs == 1 else f"Gymnasium CartPole vector {num_envs}"


def calls_per_slice(contender: "Contender | Elsewhere", seconds: float) -> int:
    """How many calls take about this long; also warms up."""
    calls = 1
    while True:
        _, took = contender.time(calls)
        if took > seconds / 4:
            return max(1, round(calls * seconds / took))
        calls *= 2


def time_all(entries: "list[Contender | Elsewhere]", rounds: int, seconds: float) -> dict[str, dict[str, list[float]]]:
    """Per contender and round: units per CPU-second and per second of the clock, units being steps or bytes."""
    plan = {entry.name: calls_per_slice(entry, seconds) for entry in entries}
    figures: dict[str, dict[str, list[float]]] = {entry.name: {"cpu": [], "wall": []} for entry in entries}
    for number in range(rounds):
        print(f"\rround {number + 1} of {rounds}", end="", file=sys.stderr, flush=True)
        for entry in entries:
            calls = plan[entry.name]
            entry.time(max(1, calls // 20))  # its data is back in the cache
            cpu, wall = entry.time(calls)
            figures[entry.name]["cpu"].append(calls * entry.per_call / cpu)
            figures[entry.name]["wall"].append(calls * entry.per_call / wall)
    print(file=sys.stderr)
    return figures


def in_subprocess(code: str, *arguments: Any, **environment: str) -> list[float]:
    """Return the numbers that a separate Python process prints."""
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        check=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | environment,
    )
    return [float(line) for line in done.stdout.split()]


def first_steps(times: int) -> dict[str, float]:
    """Seconds from the import to the end of the first step: with nothing compiled yet, and with all in the cache."""
    with tempfile.TemporaryDirectory() as folder:
        cold, *warm = [in_subprocess(FIRST_STEP, DRONE_ENV_CACHE=folder)[0] for _ in range(1 + times)]
    return {"cold": cold, "warm": statistics.median(warm)}


def memory() -> dict[str, float]:
    """Bytes per episode of each task, and what a million hard episodes take."""
    found: dict[str, float] = {}
    for task in ("easy", "medium", "hard", "skyline_easy", "skyline_medium", "skyline_hard"):
        for same_step in (False, True):
            name = f"{task}, {'SameStep' if same_step else 'NextStep'}"
            found[name] = in_subprocess(MEMORY, task, 4096, same_step)[0] / 4096
    total, *resident = in_subprocess(MEMORY, "hard", 1_000_000, False)
    found["a million hard"] = total
    if resident:
        found["a million hard, resident"] = resident[0]
    return found


def report(result: dict[str, Any]) -> None:
    """Print everything."""
    facts = result["machine"]
    packages = ", ".join(f"{name} {facts[name]}" for name in ("numpy", "numba", "gymnasium", "minigrid", "envpool"))
    print(f"{facts['cpu']}, {facts['cores']} cores, {facts['system']}, Python {facts['python']}, {packages}")
    print(f"median of {result['rounds']} rounds, all in turn; random actions, resets included")
    print()
    print(f"{'':44} {'million steps':>14} {'ns':>9} {'bytes of one':>13} {'times':>9}")
    print(f"{'':44} {'per CPU-second':>14} {'per step':>9} {'observation':>13} {'CartPole*':>9}")
    for name, row in result["steps"].items():
        rate = row["per_cpu_second"]
        ratio = "" if row["ratio"] is None else f"{row['ratio']:#.3g}"
        print(f"{name:44} {rate / 1e6:#14.4g} {1e9 / rate:9.1f} {row['observation_bytes']:13.0f} {ratio:>9}")
    print("* Gymnasium's CartPole of as many episodes")
    if result["envpool_missing"]:
        print(f"EnvPool does not install here: {result['envpool_missing']}")
    print()
    print("copying memory, and how many hard observations a second that would be:")
    for name, row in result["copying"].items():
        million = row["observations"] / 1e6
        share = f"Batch hard 4096 makes {100 * row['share']:.0f} %"
        print(f"  {name:42} {row['bytes_per_second'] / 1e9:8.1f} GB/s, {million:.0f} million; {share}")
    print("memory, bytes per episode:")
    held = result["memory"]
    for name in [name for name in held if not name.startswith("a million")]:
        print(f"  {name:42} {held[name]:8.1f}")
    note = f", resident {held['a million hard, resident'] / 1e6:.0f}" if "a million hard, resident" in held else ""
    print(f"  {'1,000,000 hard episodes, NextStep':42} {held['a million hard'] / 1e6:8.0f} MB{note}")
    start = result["first_step"]
    print("from the import to the end of the first step, in a process of its own:")
    print(f"  {'nothing compiled yet':42} {start['cold']:8.2f} s")
    print(f"  {'compiled code in the cache':42} {start['warm']:8.2f} s")


def measure(quick: bool, other: Path | None) -> dict[str, Any]:
    """All figures."""
    from contenders import COPIED, contenders

    missing = json.loads(READY.read_text())["envpool"] if READY.exists() else "not in this environment"
    rounds = 3 if quick else 11
    with batches_of(other, quick) as elsewhere:
        entries = [*contenders(quick, envpool=missing is None), *elsewhere]
        figures = time_all(entries, rounds, seconds=0.05 if quick else 0.25)

    def median(name: str, clock: str = "cpu") -> float:
        return statistics.median(figures[name][clock])

    ours = median("Batch hard 4096")
    size = next(entry.observation for entry in entries if entry.name == "Batch hard 4096")
    result: dict[str, Any] = {
        "machine": machine(),
        "rounds": rounds,
        "envpool_missing": missing,
        "steps": {},
        "copying": {},
    }
    for entry in entries:
        name = entry.name
        if entry.unit == COPIED:
            rate = median(name)
            row = {"bytes_per_second": rate, "observations": rate / size, "share": ours * size / rate}
            result["copying"][name] = row
            continue
        result["steps"][name] = {
            "per_cpu_second": median(name),
            "per_second": median(name, "wall"),
            "observation_bytes": entry.observation,
            "ratio": median(name) / median(unit) if (unit := unit_of(entry.per_call)) in figures else None,
            "rounds": figures[name],
        }
    return result


def main() -> None:
    """Prepare, measure, print."""
    parser = argparse.ArgumentParser(description="How fast the batched simulator is, beside its peers.")
    parser.add_argument("--quick", action="store_true", help="fewer contenders, fewer and shorter rounds")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures here")
    parser.add_argument("--other", type=Path, metavar="CHECKOUT", help="time this checkout's Batch in the same rounds")
    args = parser.parse_args()
    if Path(sys.prefix).resolve() != HOME:
        prepare()
        sys.exit(subprocess.run([str(PYTHON), __file__, *sys.argv[1:]]).returncode)
    result = measure(args.quick, args.other)
    print("memory and first steps ...", file=sys.stderr)
    result["memory"] = memory()
    result["first_step"] = first_steps(1 if args.quick else 3)
    report(result)
    if args.json:
        args.json.parent.mkdir(parents=True, exist_ok=True)
        args.json.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
