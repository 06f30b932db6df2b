"""Mutation testing of core, planning and results: a random sample of small faults, and those that no test notices.

    python tools/mutation.py [--sample N] [--seed N]

cosmic-ray makes the faults in a clone of the last commit and runs the tests of `TESTS` for each, one fault at a time: a
minute or two each, because changed kernels are compiled again. It prints the diff of each survivor. Not every survivor
is a gap: a fault may change nothing that users see.
"""

# pyright: basic, reportMissingImports=false
import argparse
import os
import random
import subprocess
import sys
import tempfile
from pathlib import Path

from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import TestOutcome, WorkerOutcome, WorkResult

ROOT = Path(__file__).parents[1]
PACKAGES = ("core", "planning", "results")
TESTS = "tests/unit tests/property tests/parity tests/contract tests/api/test_golden_output.py"
CONFIG = f"""
[cosmic-ray]
module-path = {[f"drone_env/{package}" for package in PACKAGES]}
timeout = 600.0
excluded-modules = []
test-command = "{sys.executable} -m pytest -x -q -n 0 -p no:cacheprovider {TESTS}"
distributor.name = "local"
"""


def sample(session: Path, size: int, seed: int) -> None:
    """Mark all faults as skipped but a random sample, which has the same number from each package."""
    with use_db(session, WorkDB.Mode.open) as work:
        rest = set()
        for package in PACKAGES:
            found = sorted(i.job_id for i in work.work_items if f"/{package}/" in str(i.mutations[0].module_path))
            rest |= set(found) - set(random.Random(seed).sample(found, min(len(found), size // len(PACKAGES))))
        work.set_multiple_results(rest, WorkResult(worker_outcome=WorkerOutcome.SKIPPED))


def main() -> int:
    """Run the command; returns 1 if the tests fail without a fault."""
    parser = argparse.ArgumentParser(description="Put random faults in, and print those that no test notices.")
    parser.add_argument("--sample", type=int, default=60, help="number of faults (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="chooses the faults (%(default)s)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="drone_env-mutation-") as folder:
        clone, session, config = Path(folder) / "clone", Path(folder) / "work.sqlite", Path(folder) / "config.toml"
        config.write_text(CONFIG, encoding="utf-8")
        subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
        # Bytecode of equal size and second would hide a fault. Compiled code is kept by the contents of its sources.
        environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1", "DRONE_ENV_CACHE": f"{folder}/cache"}
        environment |= {"PYTHONPATH": str(clone)}

        def cosmic_ray(command: str, *arguments: Path) -> int:
            program = (sys.executable, "-m", "cosmic_ray.cli", command)
            return subprocess.run([*program, config, *arguments], cwd=clone, env=environment, check=False).returncode

        if cosmic_ray("baseline"):
            return 1
        cosmic_ray("init", session)
        sample(session, options.sample, options.seed)
        cosmic_ray("exec", session)
        with use_db(session, WorkDB.Mode.open) as work:
            done = [result for _, result in work.results if result.worker_outcome != WorkerOutcome.SKIPPED]
    survivors = [result.diff for result in done if result.test_outcome == TestOutcome.SURVIVED]
    print(*survivors, f"{len(done) - len(survivors)} of {len(done)} faults caught", sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
