"""Generated parts of the documentation are up to date, and the site builds without a warning."""

import re
import sys
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image

from drone_env.core.tasks import TASKS
from tests.tools import ROOT, ran

LOADED = re.compile(r'<(?:script|img|iframe|source|link(?! rel="canonical"))\b[^>]*? (?:src|href)="(.*?)"')
"""What a browser loads by itself for a page."""
MOST_BYTES = 150_000
"""Maximum size of a film."""
OURS = re.compile(r"\bDRONE_ENV_[A-Z]+(?:_[A-Z]+)*\b")


def test_the_tables_are_up_to_date() -> None:
    done = ran(sys.executable, "tools/docs_tables.py", "--check")
    assert done.returncode == 0, done.stderr


def test_a_task_of_your_own_gets_a_page_and_a_film(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "tools")
    import docs_environments

    names = {"id": "courier", "short_name": "courier", "grader": "drone_env.graders:grade_courier"}
    monkeypatch.setattr(docs_environments, "TASKS", {"courier": replace(TASKS["easy_delivery"], deliveries=2, **names)})
    monkeypatch.setattr(docs_environments, "plugin_names", lambda: ("town.toml", "my_world"))
    files = docs_environments.site_files()
    assert [*files] == ["environments/courier.md", "environments/courier.webp"]
    page, film = files.values()
    for part in (
        "my_world:DroneDelivery-Courier-v1",
        "| parcels | 2 |",
        "uint8[10, 10]",
        "| `score` |",
        "reward_profile",
    ):
        assert part in page
    assert Image.open(BytesIO(film)).n_frames > 5
    assert len(film) < MOST_BYTES


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
    own = {f"environments/{task.short_name}.md" for task in TASKS.values()}
    assert {page for page in pages if page.startswith("environments/")} == own
    table = (site / "environments.html").read_text(encoding="utf-8")
    assert all(f'href="{page.removesuffix(".md")}.html"' in table for page in own)
    assert max(film.stat().st_size for film in (site / "environments").glob("*.webp")) < MOST_BYTES
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
