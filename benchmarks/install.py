"""Measure packages, megabytes and CPU seconds from an empty environment to the first flight.

    python benchmarks/install.py

The script builds the wheel, downloads it with all dependencies for this Python and platform, installs them into a new
environment, and flies map 7 of hard there for the first time.
"""

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.package.installed import build  # noqa: E402

FLIGHT = ("fly", "--task", "hard", "--agent", "pathqnet", "--seed", "7")


def megabytes(folder: Path) -> float:
    """Total size of the files in a folder in MB."""
    return sum(file.lstat().st_size for file in folder.rglob("*") if not file.is_dir()) / 1e6


def cpu_seconds() -> float:
    """CPU time of the processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measure(requirement: str, folder: Path) -> str:
    """A row of the table; `folder` is empty."""
    downloads, environment = folder / "downloads", folder / "env"
    subprocess.run([sys.executable, "-m", "venv", str(environment)], check=True)
    pip = [str(environment / "bin" / "python"), "-m", "pip", "--quiet", "--no-cache-dir"]
    subprocess.run([*pip, "download", "--dest", str(downloads), requirement], check=True)
    packages = next(environment.glob("lib/python*/site-packages"))
    before = megabytes(packages)
    subprocess.run([*pip, "install", "--no-index", "--find-links", str(downloads), requirement], check=True)
    disk, cpu = megabytes(packages) - before, cpu_seconds()
    variables = {"PATH": "", "HOME": str(folder), "DRONE_ENV_CACHE": str(folder / "cache")}
    subprocess.run(
        [str(environment / "bin" / "drone-env"), *FLIGHT],
        cwd=folder,
        env=variables,
        check=True,
        stdout=subprocess.DEVNULL,
    )
    count = len(list(downloads.iterdir())) - 1  # without our wheel
    return f"| {count} | {megabytes(downloads):.0f} | {disk:.0f} | {cpu_seconds() - cpu:.1f} |"


def main() -> None:
    """Measure and print a table."""
    with tempfile.TemporaryDirectory() as name:
        wheel = str(build(Path(name), "--wheel")[0])
        for extra in ("", "[server]"):
            with tempfile.TemporaryDirectory() as folder:
                row = measure(wheel + extra, Path(folder))
            print("| extra | packages | MB to download | MB on disk | first flight, CPU s |\n|---|---|---|---|---|")
            print(f"| {extra or '-'} {row}")


if __name__ == "__main__":
    main()
