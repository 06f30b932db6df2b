"""Deliberate faults, and whether a test fails for each.

Each row of tests/mutants.toml describes a fault and the tests that must catch it. In
copies of the tracked files, outside the tree, those tests run once as everything is, and must pass; then each fault is
put in alone, its tests run, and it is taken out again. Exit status 1 if a fault survives or its row is wrong.
"""

import argparse
import asyncio
import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PYTEST = ("-m", "pytest", "-x", "-q", "-n", "0", "-p", "no:cacheprovider", "--timeout", "120")
LIMIT = 300.0
"""Seconds that the tests of one fault may take."""
FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)


@dataclass
class Mutant:
    """A fault: `old`, which stands once in `file`, becomes `new`; one of `tests`, files or node ids, is to fail."""

    id: str
    file: str
    why: str
    """The effect on users."""
    old: str
    new: str
    tests: list[str]
    verdict: str = ""
    """What came of it: `caught`, `timeout` (caught, by a test that did not end), `survived` or `error`."""
    by: str = ""
    """The first test that failed, or what is wrong with the row."""
    seconds: float = 0.0
    output: str = ""

    @property
    def caught(self) -> bool:
        """Whether a test noticed."""
        return self.verdict in ("caught", "timeout")

    def put_into(self, text: str) -> str:
        """The file with the fault in it.

        Raises:
            ValueError: if the quoted code does not occur exactly once, or the result is not valid Python.
        """
        if text.count(self.old) != 1:
            raise ValueError(f"stale: what is to be replaced stands {text.count(self.old)} times in the file")
        text = text.replace(self.old, self.new)
        if self.file.endswith(".py"):
            compile(text, self.file, "exec")
        return text

    def judge(self, status: int | None, output: str) -> None:
        """Note what the tests' exit status (None where they did not end) and output say."""
        failed = FAILED.search(output.rpartition("short test summary info")[2])
        self.output = output
        if status == 0:
            self.verdict, self.by = "survived", self.why
        elif status is None:
            self.verdict, self.by = "timeout", "all of its tests together"
        elif status == 1 and failed:
            self.verdict, self.by = "timeout" if "Failed: Timeout (>" in output else "caught", failed[1]
        else:
            self.verdict, self.by = "error", f"exit status {status} of pytest: no test failed"

    def show(self) -> None:
        """Print a line of the table."""
        print(f"{self.verdict:8}  {self.id:30}  {self.file:46}  {self.by}  {self.seconds:.1f} s", flush=True)


def read_table(root: Path = ROOT) -> list[Mutant]:
    """All rows of the table; those that do not fit the files any more, or each other, are marked as errors."""
    table = tomllib.loads((root / "tests/mutants.toml").read_text(encoding="utf-8"))
    mutants = [Mutant(**row) for row in table["mutant"]]
    for mutant in mutants:
        try:
            mutant.put_into((root / mutant.file).read_text(encoding="utf-8"))
            missing = [test for test in mutant.tests if not (root / test.partition("::")[0]).exists()]
            if missing or not mutant.tests:
                raise ValueError(f"no such test: {missing}")
            if [other.id for other in mutants].count(mutant.id) > 1:
                raise ValueError("another row has the same id")
        except (OSError, SyntaxError, ValueError) as error:
            mutant.verdict, mutant.by = "error", str(error)
    return mutants


def copy_tracked(root: Path, folder: Path) -> Path:
    """Copy the tracked files of the working tree."""
    listed = subprocess.run(["git", "-C", str(root), "ls-files", "-z"], capture_output=True, check=True).stdout
    for name in filter(None, listed.decode().split("\0")):
        if (root / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, folder / name)
    return folder


async def run_tests(folder: Path, tests: Sequence[str], limit: float) -> tuple[int | None, str]:
    """Exit status and output of tests in a copy; no process is left."""
    environment = os.environ | {
        "PYTHONPATH": str(folder),
        # Compiled code is kept by the contents of the sources: shared by the copies, and not left behind.
        "DRONE_ENV_CACHE": str(folder.parent / "cache"),
        "DRONE_ENV_REQUIRE_TOOLS": "1",
    }
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    command = (sys.executable, *PYTEST, *tests)
    with tempfile.TemporaryFile() as output:
        process = await asyncio.create_subprocess_exec(
            *command, cwd=folder, env=environment, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
        )
        status = None
        try:
            with contextlib.suppress(asyncio.TimeoutError):
                status = await asyncio.wait_for(process.wait(), limit)
        finally:
            if process.returncode is None:
                process.send_signal(signal.SIGINT)  # so that tests clear up after themselves
                with contextlib.suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(process.wait(), 15)
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            await process.wait()
        output.seek(0)
        return status, output.read().decode(errors="replace")


def replace(path: Path, text: str) -> None:
    """Write a file, and forget its bytecode: it would be taken for that of another text of equal size and second."""
    path.write_text(text, encoding="utf-8")
    for compiled in path.parent.glob(f"__pycache__/{path.stem}.*.pyc"):
        compiled.unlink()


async def judge_all(mutants: Sequence[Mutant], root: Path, jobs: int, limit: float) -> None:
    """Judge faults in parallel, and print the caught ones.

    Raises:
        SystemExit: if the tests fail without any.
    """
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, asyncio.current_task().cancel)  # pyright: ignore
    left = iter(mutants)

    async def work(folder: Path) -> None:
        for mutant in left:
            path = folder / mutant.file
            whole, began = path.read_text(encoding="utf-8"), time.monotonic()
            replace(path, mutant.put_into(whole))
            mutant.judge(*await run_tests(folder, mutant.tests, limit))
            replace(path, whole)
            mutant.seconds = round(time.monotonic() - began, 1)
            if mutant.caught:
                mutant.show()

    with tempfile.TemporaryDirectory(prefix="drone_env-mutants-") as temporary:
        folders = [copy_tracked(root, Path(temporary) / f"copy{i}") for i in range(jobs)]
        tests = sorted({test for mutant in mutants for test in mutant.tests})
        shares = [tests[len(tests) * i // jobs : len(tests) * (i + 1) // jobs] for i in range(jobs)]
        # Pytest runs everything where no test is named.
        chosen = [(folder, share) for folder, share in zip(folders, shares, strict=True) if share]
        unmutated = [run_tests(folder, share, 4 * limit) for folder, share in chosen]
        for status, output in await asyncio.gather(*unmutated):
            if status != 0:
                raise SystemExit(f"{output}\nthe tests fail (exit status {status}) with no fault put in")
        await asyncio.gather(*map(work, folders))


def main(arguments: Sequence[str] | None = None, root: Path = ROOT, limit: float = LIMIT) -> int:
    """Run the command; returns the exit status."""
    parser = argparse.ArgumentParser(description="Break the package on purpose, and see whether the tests notice.")
    parser.add_argument("--only", metavar="ID|PATH", default="", help="rows whose id, or file, begins so")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="how many at once")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write rows, verdicts and pytest's output")
    options = parser.parse_args(arguments)
    chosen = [row for row in read_table(root) if row.id.startswith(options.only) or row.file.startswith(options.only)]
    sound = [mutant for mutant in chosen if not mutant.verdict]
    if sound:
        asyncio.run(judge_all(sound, root, max(1, min(options.jobs, len(sound))), limit))
    for mutant in chosen:
        if not mutant.caught:
            mutant.show()
    if options.json:
        options.json.write_text(json.dumps([asdict(mutant) for mutant in chosen], indent=1) + "\n", encoding="utf-8")
    caught = sum(mutant.caught for mutant in chosen)
    print(f"{caught} of {len(chosen)} faults caught")
    return 0 if caught == len(chosen) > 0 else 1


if __name__ == "__main__":
    sys.exit(main())
