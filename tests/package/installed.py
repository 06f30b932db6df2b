"""Check the wheel and the source distribution in empty environments, outside the checkout.

    python tests/package/installed.py [--python 3.10 3.11 3.12 3.13 3.14]

The wheel that is built from the source distribution must equal the wheel from the checkout, byte for byte. For each
Python: a fresh environment in a temporary folder, the wheel with the extra `server` (for the last one the source
distribution, too), then from another folder `drone-env --version`, `fly`, `evaluate`, `doctor` and `serve`; the page
and all its files are requested, and an episode is started over HTTP.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

import httpx  # noqa: E402

from drone_env import __version__  # noqa: E402
from tests.stranger import background  # noqa: E402
from tests.tools import PATIENCE, path_of_python, reserved_port, tracked  # noqa: E402


def copy_tracked(folder: Path) -> None:
    """Copy the tracked files into a new folder, as they are now."""
    for name in tracked():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, folder / name)


def build(folder: Path, *kinds: str) -> list[Path]:
    """Build a copy of the tracked files, so that nothing is left in the checkout.

    Without a kind, build the source distribution, and the wheel from it.
    """
    source = folder / "source"
    copy_tracked(source)
    command = [sys.executable, "-m", "build", "--no-isolation", *kinds, "--outdir", str(folder / "dist"), str(source)]
    subprocess.run(command, check=True, capture_output=True)
    return sorted((folder / "dist").iterdir())


class Installed:
    """A wheel or a source distribution, installed.

    Args:
        file: The wheel or source distribution.
        python: The interpreter to make the environment with; None for this one, with its dependencies.
        folder: An empty folder.
    """

    def __init__(self, file: Path, python: str | None, folder: Path) -> None:
        self.place = folder / "elsewhere"
        self.place.mkdir()
        self.bin = folder / "env" / "bin"
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "DRONE_ENV_"))}
        self.environment = kept
        own = str(self.bin / "python")
        if python is None:
            venv.create(folder / "env", with_pip=False)
            # A path in a .pth file adds the folder alone: the checkout that is installed there as editable stays out.
            packages = next((folder / "env").glob("lib/python*/site-packages"))
            (packages / "dependencies.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
            alone = ["--no-deps", "--no-index", "--no-build-isolation", str(file)]
            command = [sys.executable, "-m", "pip", "--python", own, "install", "--quiet", *alone]
        else:
            # An empty cache of compiled code, as on a new machine.
            self.environment = {**kept, "DRONE_ENV_CACHE": str(folder / "cache")}
            subprocess.run([python, "-m", "venv", str(folder / "env")], check=True, env=self.environment)
            command = [own, "-m", "pip", "install", "--quiet", f"{file}[server]"]
        self.packages = next((folder / "env").glob("lib/python*/site-packages"))
        subprocess.run(command, check=True, env=self.environment)

    def run(self, program: str, *arguments: str) -> str:
        """Return the standard output of a program of the environment, run from another folder."""
        command = [str(self.bin / program), *arguments]
        done = subprocess.run(
            command, cwd=self.place, env=self.environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{' '.join(command)}: exit status {done.returncode}: {done.stderr}"
        return done.stdout

    def check_commands(self) -> None:
        """Check version, origin, flights, evaluation and doctor."""
        flown = self.run("drone-env", "fly", "--task", "hard", "--agent", "pathqnet", "--seed", "7")
        assert flown.splitlines()[-1].startswith("[END] success=true"), flown
        assert self.run("drone-env", "--version").split() == ["drone-env", __version__]
        origin = self.run("python", "-c", "import drone_env; print(drone_env.__file__)").strip()
        assert Path(origin).is_relative_to(self.packages), origin
        options = ["--task", "easy", "--agents", "greedy", "optimal", "--episodes", "5", "--json"]
        evaluated = json.loads(self.run("drone-env", "evaluate", *options))
        assert evaluated["tasks"]["easy_delivery"]["agents"]["optimal"]["score_ratio"] == 1
        assert self.run("drone-env", "doctor").endswith("Flights can be flown.\n")

    def check_server(self, files: list[str]) -> None:
        """Check the page with all its files, and a step over HTTP."""
        port = reserved_port()
        command = [str(self.bin / "drone-env"), "serve", "--port", str(port)]
        with (
            background(command, port, self.place, self.environment),
            httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=PATIENCE) as client,
        ):
            assert client.get("/health").json()["status"] == "healthy"
            for file in files:
                assert client.get(f"/static/{file}").raise_for_status().content, file
            assert len(client.post("/reset", json={"task_name": "hard_delivery", "seed": 7}).json()["grid"]) == 18
            # Last, because the server compiles the first solver for it.
            assert "<title>" in client.get("/").raise_for_status().text


def contents(wheel: Path) -> dict[str, bytes]:
    """The files of a wheel by their names."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def page_files(wheel: Path) -> list[str]:
    """All files of the page that are not empty, as the server names them."""
    prefix = "drone_env/server/static/"
    return [name.removeprefix(prefix) for name, held in contents(wheel).items() if name.startswith(prefix) and held]


def check(file: Path, page: list[str], python: str | None = None) -> None:
    """Install a wheel or a source distribution, and check it.

    Raises:
        AssertionError, OSError, httpx.HTTPError: if something does not work.
        subprocess.CalledProcessError: if it cannot be installed.
    """
    with tempfile.TemporaryDirectory() as folder:
        installed = Installed(file, python, Path(folder))
        installed.check_commands()
        installed.check_server(page)


def main() -> int:
    """Check each Python; return 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", nargs="+", default=["3.10", "3.11", "3.12", "3.13", "3.14"], metavar="X.Y")
    versions: list[str] = parser.parse_args().python
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        source, wheel = sorted(build(Path(folder)), key=lambda file: file.suffix == ".whl")
        (direct,) = build(Path(folder) / "direct", "--wheel")
        if contents(wheel) != contents(direct):
            sys.exit("the wheel from the source distribution is not the one from the checkout")
        for version, file in [*((version, wheel) for version in versions), (versions[-1], source)]:
            python = path_of_python(version)
            if python is None:
                print(f"{version} {file.name}: not run, no Python {version} here", flush=True)
                continue
            try:
                check(file, page_files(wheel), python)
                print(f"{version} {file.name}: works", flush=True)
            except (AssertionError, OSError, httpx.HTTPError, subprocess.CalledProcessError) as error:
                failed = 1
                print(f"{version} {file.name}: failed: {error}", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main())
