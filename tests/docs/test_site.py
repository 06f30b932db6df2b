"""Generated parts of the documentation are up to date, and the site builds without a warning."""

import re
import sys
from pathlib import Path

import pytest

from tests.tools import ROOT, ran

LOADED = re.compile(r'<(?:script|img|iframe|source|link(?! rel="canonical"))\b[^>]*? (?:src|href)="(.*?)"')
"""What a browser loads by itself for a page."""
OURS = re.compile(r"\bDRONE_ENV_[A-Z]+(?:_[A-Z]+)*\b")


def test_the_tables_are_up_to_date() -> None:
    done = ran(sys.executable, "tools/docs_tables.py", "--check")
    assert done.returncode == 0, done.stderr


def test_every_variable_that_the_package_reads_is_documented() -> None:
    page = (ROOT / "docs" / "configuration.md").read_text(encoding="utf-8")
    read = {
        name
        for file in (ROOT / "drone_env").rglob("*.py")
        for line in file.read_text(encoding="utf-8").splitlines()
        if "environ" in line
        for name in OURS.findall(line)
    }
    assert "DRONE_ENV_CACHE" in read
    assert {name for name in read if f"`{name}`" not in page} == set()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site; a broken link or anchor, a page outside the navigation or a wrong docstring ends its making."""
    folder = tmp_path_factory.mktemp("site")
    done = ran(sys.executable, "-m", "mkdocs", "build", "--site-dir", folder, NO_MKDOCS_2_WARNING="1")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.long
def test_the_site_is_whole_and_loads_nothing_from_elsewhere(site: Path) -> None:
    pages = {page.relative_to(site).with_suffix(".md").as_posix() for page in site.rglob("*.html")}
    sources = {page.relative_to(ROOT / "docs").as_posix() for page in (ROOT / "docs").rglob("*.md")}
    assert sources | {"index.md", "changelog.md", "contributing.md"} <= pages
    for page in site.rglob("*.html"):
        loaded = LOADED.findall(page.read_text(encoding="utf-8"))
        assert loaded
        assert [address for address in loaded if "//" in address] == [], page
    for style in (*site.rglob("*.css"), *site.rglob("*.svg")):
        assert "url(http" not in style.read_text(encoding="utf-8"), style


@pytest.mark.long
def test_the_reference_holds_what_the_package_offers(site: Path) -> None:
    import drone_env

    page = (site / "reference.html").read_text(encoding="utf-8")
    promised = [(home, name) for home, names in drone_env._HOMES.items() for name in names]
    assert {name for _, name in promised} | {"__version__"} == set(drone_env.__all__)
    missing = [name for home, name in promised if f'id="drone_env.{home}.{name}"' not in page]
    assert missing == []
