"""Seconds and megabytes from an empty environment to the first flight, beside the original's list of dependencies.

    python benchmarks/install.py [--json FILE]

Our wheel is built, resolved, installed with pip into a fresh environment (nothing taken from a cache), and flies map 7
of hard from another folder, for the first time. The dependencies of the project's first version are resolved for the
same Python and platform, not installed: uv chooses the versions from metadata alone, and the sizes are those that the
files have on the package index.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from packaging.tags import sys_tags
from packaging.utils import parse_wheel_filename

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from drone_env.errors import DISTRIBUTION  # noqa: E402
from tests.package.installed import build  # noqa: E402

ORIGINAL = ("openenv-core[core]>=0.2.1", "torch>=2.0.0", "openai>=1.0.0", "python-multipart>=0.0.9")
MEGABYTE = 1e6
FLIGHT = ("fly", "--task", "hard", "--agent", "pathqnet", "--seed", "7")


def megabytes(folder: Path) -> float:
    """The total size of the files in a folder, in MB."""
    return sum(file.lstat().st_size for file in folder.rglob("*") if not file.is_dir()) / 1e6


def resolve(requirements: Sequence[str], folder: Path) -> list[dict[str, Any]]:
    """The packages that an installer would fetch for this Python and platform, from their metadata alone."""
    wanted, lock = folder / "requirements.in", folder / "pylock.toml"
    wanted.write_text("\n".join(requirements) + "\n", encoding="utf-8")
    compiled = [sys.executable, "-m", "uv", "pip", "compile", "--quiet", "--format", "pylock.toml", str(wanted)]
    subprocess.run([*compiled, "--python", sys.executable, "--output-file", str(lock)], check=True, cwd=folder)
    return tomllib.loads(lock.read_text(encoding="utf-8"))["packages"]


def size_of(package: dict[str, Any]) -> int:
    """Bytes of the file that an installer would take: the best wheel for this platform, else the sources.

    Raises:
        OSError: if the index does not answer.
    """
    ranks = {tag: rank for rank, tag in enumerate(sys_tags())}

    def rank(file: dict[str, Any]) -> int:
        tags = parse_wheel_filename(file["url"].rpartition("/")[2])[3]
        return min((ranks[tag] for tag in tags if tag in ranks), default=len(ranks))

    wheels = [wheel for wheel in package.get("wheels", []) if rank(wheel) < len(ranks)]
    file = min(wheels, key=rank) if wheels else package["sdist"]
    if "size" in file:
        return int(file["size"])
    with urllib.request.urlopen(urllib.request.Request(file["url"], method="HEAD"), timeout=60) as answer:
        return int(answer.headers["Content-Length"])


def download(requirements: Sequence[str]) -> dict[str, Any]:
    """How many packages and bytes come with these requirements."""
    with tempfile.TemporaryDirectory() as folder:
        packages = resolve(requirements, Path(folder))
    # A package without a URL is the local wheel.
    fetched = [package for package in packages if package.get("wheels") or package.get("sdist")]
    with ThreadPoolExecutor(8) as threads:
        sizes = list(threads.map(size_of, fetched))
    largest = sorted(zip(sizes, (package["name"] for package in fetched), strict=True), reverse=True)[:5]
    return {"packages": len(fetched), "download_mb": sum(sizes) / MEGABYTE, "largest": largest}


def install(requirement: str) -> dict[str, Any]:
    """Seconds and megabytes of installing our wheel, and seconds of the first flight."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        subprocess.run([sys.executable, "-m", "venv", str(folder / "env")], check=True)
        packages = next((folder / "env").glob("lib/python*/site-packages"))
        before = megabytes(packages)
        python = str(folder / "env" / "bin" / "python")
        start, start_cpu = time.monotonic(), cpu_seconds()
        subprocess.run([python, "-m", "pip", "install", "--quiet", "--no-cache-dir", requirement], check=True)
        installed, installed_cpu = time.monotonic(), cpu_seconds()
        size = megabytes(packages) - before
        environment = {"PATH": "", "HOME": name, "DRONE_ENV_CACHE": str(folder / "cache")}
        command = [str(folder / "env" / "bin" / "drone-env"), *FLIGHT]
        flown = subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True, text=True)
        if not flown.stdout.splitlines()[-1].startswith("[END] success=true"):
            raise SystemExit(f"the first flight failed: {flown.stdout}")
        end, end_cpu = time.monotonic(), cpu_seconds()
    return {
        "install_s": installed - start,
        "install_cpu_s": installed_cpu - start_cpu,
        "disk_mb": size,
        "first_flight_s": end - installed,
        "first_flight_cpu_s": end_cpu - installed_cpu,
    }


def cpu_seconds() -> float:
    """CPU time of the processes that have ended, which other load on the machine hardly changes."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    rows: dict[str, dict[str, Any]] = {}
    print("| | packages | MB to download | MB on disk | install s (CPU) | first flight s (CPU) |")
    print("|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        wheel = build(Path(folder), "--wheel")[0]
        ours = {"base, `drone-env fly`": str(wheel), "`[server]`": f"{wheel}[server]"}
        for name, requirement in ours.items():
            resolved = download([f"{DISTRIBUTION}{requirement.removeprefix(str(wheel))} @ {wheel.as_uri()}"])
            rows[name] = {**resolved, **install(requirement)}
            row = rows[name]
            print(
                f"| {name} | {row['packages']} | {row['download_mb']:.0f} | {row['disk_mb']:.0f} | "
                f"{row['install_s']:.0f} ({row['install_cpu_s']:.0f}) | "
                f"{row['first_flight_s']:.1f} ({row['first_flight_cpu_s']:.1f}) |",
                flush=True,
            )
    row = rows["original"] = download(ORIGINAL)
    print(f"| the first version's list | {row['packages']} | {row['download_mb']:,.0f} | - | - | - |")
    for name, figures in rows.items():
        largest = ", ".join(f"{package} {size / MEGABYTE:,.0f} MB" for size, package in figures["largest"])
        print(f"\n{name}, the largest: {largest}", end="")
    print()
    if args.json is not None:
        args.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
