"""Wheel and source distribution: their files, and both installed outside the checkout."""

import re
import subprocess
import sys
import tarfile
import zipfile
from email.parser import Parser
from pathlib import Path

import pytest
import yaml

from drone_env import __version__
from drone_env.errors import DISTRIBUTION
from tests.package.installed import build, check, page_files
from tests.tools import ROOT, tracked

NAME = f"{DISTRIBUTION.replace('-', '_')}-{__version__}"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """By suffix: the source distribution, and the wheel that was built from it."""
    return {path.suffix: path for path in build(tmp_path_factory.mktemp("built"))}


@pytest.mark.long
def test_the_wheel_holds_the_package_and_nothing_else(built: dict[str, Path]) -> None:
    with zipfile.ZipFile(built[".whl"]) as wheel:
        names = set(wheel.namelist())
    about = {name for name in names if name.startswith(f"{NAME}.dist-info/")}
    assert names - about == {*tracked("drone_env")}
    assert {name.removeprefix(f"{NAME}.dist-info/") for name in about} == {
        "METADATA", "RECORD", "WHEEL", "entry_points.txt", "licenses/LICENSE", "top_level.txt"
    }  # fmt: skip


@pytest.mark.long
def test_the_source_distribution_holds_what_a_wheel_is_built_from(built: dict[str, Path]) -> None:
    with tarfile.open(built[".gz"]) as archive:
        names = {member.name.removeprefix(f"{NAME}/") for member in archive.getmembers() if member.isfile()}
    made = {name for name in names if name.startswith("drone_delivery_env.egg-info/")} | {"PKG-INFO", "setup.cfg"}
    sources = tracked("drone_env", "CITATION.cff", "LICENSE", "MANIFEST.in", "README.md", "pyproject.toml")
    assert names - made == {*sources}


@pytest.mark.long
def test_the_description_renders_and_names_every_python(built: dict[str, Path]) -> None:
    command = [sys.executable, "-m", "twine", "check", "--strict", *map(str, built.values())]
    checked = subprocess.run(command, capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout
    with zipfile.ZipFile(built[".whl"]) as wheel:
        metadata = Parser().parsestr(wheel.read(f"{NAME}.dist-info/METADATA").decode())
    assert (metadata["Name"], metadata["Version"]) == (DISTRIBUTION, __version__)
    assert metadata["Requires-Python"] == ">=3.10"
    pythons = [name.rpartition(" ")[2] for name in metadata.get_all("Classifier", []) if ":: Python :: 3." in name]
    assert pythons == ["3.10", "3.11", "3.12", "3.13", "3.14"]


VERSIONED = {"CHANGELOG.md", "CITATION.cff", "drone_env/__init__.py", "openenv.yaml"}
"""The one place that everything reads, and those that must repeat it."""


def test_the_version_stands_in_one_place_and_in_files_that_agree() -> None:
    manifest, cited = (yaml.safe_load((ROOT / name).read_text("utf-8")) for name in ("openenv.yaml", "CITATION.cff"))
    released = re.search(r"^## (\d\S*) - (\S+)$", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert released is not None
    assert [manifest["version"], cited["version"], released[1]] == [__version__] * 3
    assert str(cited["date-released"]) == released[2]
    # Where a requirement names another package's version of the same digits, an operator stands before it.
    literal = re.compile(rf"(?<![\w.=~<>]){re.escape(__version__)}(?![\w.])")
    told = {
        name
        for name in {*tracked()} - {"uv.lock"}
        if "/vendor/" not in name
        # What an older version made, or said, keeps the name of its maker.
        and not name.startswith(("tests/", "docs/quoting.md", "leaderboard/"))
        and literal.search((ROOT / name).read_bytes().decode("utf-8", "replace"))
    }
    assert told == VERSIONED, "read drone_env.__version__ there instead"


@pytest.mark.long
@pytest.mark.parametrize("kind", [".whl", pytest.param(".gz", marks=pytest.mark.campaign)])
def test_what_is_handed_out_works_outside_the_checkout(built: dict[str, Path], kind: str) -> None:
    page = page_files(built[".whl"])
    assert len(page) > 50
    check(built[kind], page)
