"""Wheel and source distribution in empty environments, outside the checkout: does all that they promise work there?

    python tests/package/installed.py [--python 3.10 3.11 3.12 3.13] [--uv | --offline] [--json FILE]

The wheel that is built from the source distribution is to hold what the wheel from the checkout holds, byte for byte.
For each Python: a fresh environment in a temporary folder, the wheel with the extra `server` (for the last one the
source distribution, too), then from another folder `drone-env --version`, `fly`, `evaluate`, `doctor` and `serve`; the
page and all its files are asked for, and a mission is begun over HTTP. With --uv, uv installs instead of pip. With
--offline, the dependencies are those of the Python that runs this, and only the package itself comes from the file.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
import urllib.request
import venv
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from drone_env.installer import DISTRIBUTION  # noqa: E402
from tests.tools import path_of_python, reserved_port  # noqa: E402

TASKS = ("easy_delivery", "medium_delivery", "hard_delivery")


def copy_tracked(folder: Path) -> None:
    """Copy the tracked files into a new folder, as they are now."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)


def build(folder: Path, *kinds: str) -> list[Path]:
    """What `python -m build` makes of a copy of the tracked files, so that nothing is left in the checkout.

    Where no kind is named: the source distribution, and the wheel that is built from it.
    """
    source = folder / "source"
    copy_tracked(source)
    command = [sys.executable, "-m", "build", "--no-isolation", *kinds, "--outdir", str(folder / "dist"), str(source)]
    subprocess.run(command, check=True, capture_output=True)
    return sorted((folder / "dist").iterdir())


def megabytes(folder: Path) -> float:
    """What the files of a folder add up to, in MB."""
    return sum(file.lstat().st_size for file in folder.rglob("*") if not file.is_dir()) / 1e6


class Installed:
    """A wheel or a source distribution, installed.

    Args:
        file: What is installed.
        python: The interpreter to make the environment with.
        folder: An empty folder.
        offline: Whether to take the dependencies of the Python that runs this.
        uv: Whether uv installs.
    """

    def __init__(self, file: Path, python: str, folder: Path, offline: bool, uv: bool) -> None:
        self.place = folder / "elsewhere"
        self.place.mkdir()
        self.bin = folder / "env" / "bin"
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "DRONE_ENV_"))}
        # Compiled code of its own, as on a machine that never saw the package.
        self.environment = {**kept, "DRONE_ENV_CACHE": str(folder / "cache")}
        start = time.monotonic()
        if offline:
            venv.create(folder / "env", with_pip=False)
            self.packages = next((folder / "env").glob("lib/python*/site-packages"))
            # A path in a .pth file adds the folder alone: the checkout that is installed there as editable stays out.
            (self.packages / "dependencies.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
            alone = ["--quiet", "--no-deps", "--no-index", "--no-build-isolation", str(file)]
            to = ["--python", str(self.bin / "python"), "install", *alone]
            subprocess.run([sys.executable, "-m", "pip", *to], check=True, env=self.environment)
        else:
            subprocess.run([python, "-m", "venv", str(folder / "env")], check=True, env=self.environment)
            self.packages = next((folder / "env").glob("lib/python*/site-packages"))
            before = megabytes(self.packages)
            own = str(self.bin / "python")
            pip = (
                [sys.executable, "-m", "uv", "pip", "install", "--python", own] if uv else [own, "-m", "pip", "install"]
            )
            subprocess.run([*pip, "--quiet", f"{file}[server]"], check=True, env=self.environment)
            self.megabytes = megabytes(self.packages) - before
        self.seconds = time.monotonic() - start

    def run(self, *arguments: str) -> str:
        """Standard output of `drone-env`, run from another folder; ends the program where it fails."""
        command = [str(self.bin / "drone-env"), *arguments]
        done = subprocess.run(
            command, cwd=self.place, env=self.environment, capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            raise AssertionError(f"drone-env {' '.join(arguments)}: exit status {done.returncode}: {done.stderr}")
        return done.stdout

    def python(self, code: str) -> list[str]:
        """The lines that a program prints there."""
        command = [str(self.bin / "python"), "-c", code]
        return subprocess.check_output(command, cwd=self.place, env=self.environment, text=True).splitlines()

    def check_commands(self) -> dict[str, Any]:
        """Version, origin, flights, evaluation, doctor; the seconds of the first flight."""
        start = time.monotonic()
        flown = self.run("fly", "--task", "hard", "--agent", "pathqnet", "--seed", "7")
        first_flight = time.monotonic() - start
        assert flown.splitlines()[-1].startswith("[END] success=true"), flown
        version = self.run("--version").split()
        assert version[0] == "drone-env", version
        where, hint = self.python("import drone_env, drone_env.installer as i; print(drone_env.__file__)"
                                  "; print(i.install_command('train'))")  # fmt: skip
        assert Path(where).is_relative_to(self.packages), where
        assert hint.endswith(f"pip install '{DISTRIBUTION}[train]'"), hint
        judged = json.loads(self.run("evaluate", "--task", "easy", "--agents", "greedy", "optimal", "--episodes", "5",
                                     "--json", "-"))  # fmt: skip
        assert judged["tasks"]["easy_delivery"]["agents"]["optimal"]["score_ratio"] == 1
        doctor = json.loads(self.run("doctor", "--json"))
        assert doctor["healthy"], doctor
        networks = {finding["name"] for finding in doctor["findings"] if finding["topic"] == "networks"}
        assert networks == {*TASKS, "tournet"}, networks
        return {"version": version[1], "first_flight_s": first_flight}

    def check_server(self, files: list[str]) -> float:
        """The page with all its files, and a step over HTTP; the seconds until the server answered."""
        url = f"http://127.0.0.1:{reserved_port()}"
        log = (self.place / "serve.log").open("wb")
        start = time.monotonic()
        server = subprocess.Popen(
            [str(self.bin / "drone-env"), "serve", "--port", url.rpartition(":")[2]],
            cwd=self.place, env=self.environment, stdout=log, stderr=log,
        )  # fmt: skip
        try:
            self._wait(lambda: json.loads(get(f"{url}/health"))["status"] == "healthy", server)
            answered = time.monotonic() - start
            for file in files:
                assert get(f"{url}/static/{file}"), file
            body = json.dumps({"task_name": "hard_delivery", "seed": 7}).encode()
            request = urllib.request.Request(f"{url}/reset", body, {"Content-Type": "application/json"})
            assert len(json.loads(get(request))["grid"]) == 18
            # Last, as it has the server compile the first solver.
            assert b"<title>" in get(f"{url}/")
        finally:
            server.terminate()
            try:
                server.wait(timeout=60)
            finally:
                server.kill()
                server.wait()
                log.close()
        return answered

    def _wait(self, holds: Callable[[], bool], server: "subprocess.Popen[bytes]") -> None:
        deadline = time.monotonic() + 180
        while time.monotonic() < deadline:
            assert server.poll() is None, (self.place / "serve.log").read_text()
            try:
                if holds():
                    return
            except OSError:
                time.sleep(0.1)
        raise AssertionError(f"the server did not answer: {(self.place / 'serve.log').read_text()}")


def get(request: "str | urllib.request.Request") -> bytes:
    """The body of an answer; anything but 200 is an error."""
    with urllib.request.urlopen(request, timeout=60) as answer:
        assert answer.status == 200, answer.status
        return answer.read()


def contents(wheel: Path) -> dict[str, bytes]:
    """The files of a wheel by their names."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def page_files(wheel: Path) -> list[str]:
    """All files of the page that are not empty, as the server names them."""
    prefix = "drone_env/server/static/"
    return [name.removeprefix(prefix) for name, held in contents(wheel).items() if name.startswith(prefix) and held]


def check(file: Path, page: list[str], python: str, offline: bool = False, uv: bool = False) -> dict[str, Any]:
    """Install a wheel or a source distribution and try everything; the figures.

    Raises:
        AssertionError: if something does not work.
        subprocess.CalledProcessError: if it cannot be installed.
    """
    with tempfile.TemporaryDirectory() as folder:
        installed = Installed(file, python, Path(folder), offline, uv)
        figures = installed.check_commands()
        answered = installed.check_server(page)
        size = None if offline else installed.megabytes
        return {
            "install_s": installed.seconds, "megabytes": size, **figures, "server_s": answered, "page_files": len(page)
        }  # fmt: skip


def main() -> int:
    """Check each Python and print a table; 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", nargs="+", default=["3.10", "3.11", "3.12", "3.13"], metavar="X.Y")
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--uv", action="store_true", help="have uv install, which takes a fraction of the time")
    how.add_argument("--offline", action="store_true", help="this Python and its dependencies, whatever --python says")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    args = parser.parse_args()
    versions = [sysconfig.get_python_version()] if args.offline else args.python
    pythons = {version: path_of_python(version) for version in versions}
    if None in pythons.values():
        sys.exit(f"not here: Python {', '.join(v for v, path in pythons.items() if path is None)}")
    results: dict[str, Any] = {}
    print("| python | from | install s | MB | first flight s | server answers after s | files of the page | |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        source, wheel = sorted(build(Path(folder)), key=lambda file: file.suffix == ".whl")
        (direct,) = build(Path(folder) / "direct", "--wheel")
        if contents(wheel) != contents(direct):
            sys.exit("the wheel from the source distribution is not the one from the checkout")
        page = page_files(wheel)
        tries = [(version, "wheel", wheel) for version in versions] + [(versions[-1], "sdist", source)]
        for version, kind, file in tries:
            try:
                figures = check(file, page, str(pythons[version]), args.offline, args.uv)
            except (AssertionError, OSError, subprocess.CalledProcessError) as error:
                results[f"{version} {kind}"] = {"error": str(error)}
                print(f"| {version} | {kind} | | | | | | failed: {error} |", flush=True)
                continue
            results[f"{version} {kind}"] = figures
            size = "-" if figures["megabytes"] is None else f"{figures['megabytes']:.0f}"
            print(
                f"| {version} | {kind} | {figures['install_s']:.0f} | {size} | {figures['first_flight_s']:.1f} | "
                f"{figures['server_s']:.1f} | {figures['page_files']} | works |",
                flush=True,
            )
    if args.json is not None:
        args.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    return int(any("error" in figures for figures in results.values()))


if __name__ == "__main__":
    sys.exit(main())
