"""What is handed out: the files of wheel and source distribution, and the wheel installed outside the checkout."""

import subprocess
import sys
import tarfile
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest

from drone_env import __version__
from tests.package.installed import ROOT, build, check

NAME = f"drone_env-{__version__}"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {path.suffix: path for path in build(tmp_path_factory.mktemp("built"), "--wheel", "--sdist")}


def tracked(*folders: str) -> set[str]:
    listed = subprocess.run(["git", "ls-files", "-z", *folders], cwd=ROOT, capture_output=True, text=True, check=True)
    return {name for name in listed.stdout.split("\0") if (ROOT / name).is_file()}


def test_the_wheel_holds_the_package_and_nothing_else(built: dict[str, Path]) -> None:
    with zipfile.ZipFile(built[".whl"]) as wheel:
        names = set(wheel.namelist())
    about = {name for name in names if name.startswith(f"{NAME}.dist-info/")}
    assert names - about == tracked("drone_env")
    assert {name.removeprefix(f"{NAME}.dist-info/") for name in about} == {
        "METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE", "top_level.txt"
    }  # fmt: skip


def test_the_source_distribution_holds_what_a_wheel_is_built_from(built: dict[str, Path]) -> None:
    with tarfile.open(built[".gz"]) as archive:
        names = {member.name.removeprefix(f"{NAME}/") for member in archive.getmembers() if member.isfile()}
    made = {name for name in names if name.startswith("drone_env.egg-info/")} | {"PKG-INFO", "setup.cfg"}
    assert names - made == tracked("drone_env", "LICENSE", "MANIFEST.in", "README.md", "pyproject.toml")


def test_the_description_renders(built: dict[str, Path]) -> None:
    command = [sys.executable, "-m", "twine", "check", "--strict", *map(str, built.values())]
    checked = subprocess.run(command, capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout
    assert checked.stdout.count("PASSED") == 2


def test_the_metadata_names_every_python_that_is_supported(built: dict[str, Path]) -> None:
    with zipfile.ZipFile(built[".whl"]) as wheel:
        metadata = Parser().parsestr(wheel.read(f"{NAME}.dist-info/METADATA").decode())
    assert (metadata["Name"], metadata["Version"]) == ("drone-env", __version__)
    assert metadata["Requires-Python"] == ">=3.10"
    pythons = [name.rpartition(" ")[2] for name in metadata.get_all("Classifier", []) if ":: Python :: 3." in name]
    assert pythons == ["3.10", "3.11", "3.12", "3.13"]


@pytest.mark.long
def test_the_wheel_works_outside_the_checkout(built: dict[str, Path]) -> None:
    figures = check(built[".whl"], sys.executable, offline=True)
    assert figures["version"] == __version__
    assert figures["page_files"] > 50
