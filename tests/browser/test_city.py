"""Large maps and real places: joined to blocks, seen from nearby beside a small map, with whose data they show."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, expect

from tests.api.serving import serving
from tests.browser.shown import expect_step, offset, painted, pictures
from tests.browser.stage import fly, show
from tests.browser.tabs import PATIENCE_MS, Tabs
from tests.browser.test_everybody import findings
from tests.docs.pages import ROOT, blocks
from tests.docs.shell import commands

CONTRIBUTORS = "© OpenStreetMap contributors"
GROUND = "#boards .map-ground"
JOINED = ("--block-street", "--block-roof-1", "--block-wood", "--block-closed")


def test_a_city_is_joined_to_blocks_is_seen_from_nearby_and_says_whose_data_it_shows(page: Page) -> None:
    small = page.get_by_role("img", name="The whole map, with what is in sight")
    credit = page.get_by_role("link", name=CONTRIBUTORS)
    farther, nearer = (page.get_by_role("button", name=name) for name in ("Farther", "Nearer"))
    show(page, "/?task=city&seed=7&pilots=greedy")
    expect(credit).to_have_attribute("href", "https://www.openstreetmap.org/copyright")
    assert painted(page.locator(GROUND), *JOINED) == list(JOINED)
    expect(small).to_be_hidden()
    for _ in range(3):
        nearer.click()
    expect(small).to_be_visible()
    page.evaluate(Axe().axe_script)
    assert findings(page, ".boards-panel") == []
    # A click on the small map shows that place, and the keys move on from there.
    box = small.bounding_box()
    assert box
    small.click(position={"x": 0.3 * box["width"], "y": 0.7 * box["height"]})
    clicked = offset(page)
    expect(page.get_by_role("button", name="Follow the drone")).to_be_visible()
    page.keyboard.press("Shift+ArrowRight")
    moved = offset(page)
    assert moved[0] < clicked[0]
    assert moved[1] == clicked[1]
    # The wheel zooms to the pointer: the cell below it stays below it.
    field = page.locator("#boards .map").bounding_box()
    assert field
    x, y = field["x"] + 0.6 * field["width"], field["y"] + 0.55 * field["height"]
    page.mouse.move(x, y)
    below: list[tuple[float, float]] = []
    page.keyboard.down("Control")
    for _ in range(3):
        page.mouse.wheel(0, -100)
        pictures(page)
        ground = page.locator(GROUND).bounding_box()
        assert ground
        below.append(((x - ground["x"]) / ground["width"], (y - ground["y"]) / ground["height"]))
    page.keyboard.up("Control")
    assert below[2] == pytest.approx(below[1], abs=0.01)
    # A person starts nearby; a map of the standard tasks has no blocks and nothing around it.
    show(page, "/?task=city&seed=7&pilots=human")
    expect(farther).to_be_enabled()
    show(page, "/?task=easy&seed=7&pilots=greedy")
    expect_step(page, 0, 60)
    expect(credit).to_be_hidden()
    expect(small).to_be_hidden()
    assert painted(page.locator(GROUND), *JOINED) == []


@pytest.mark.long
def test_three_commands_of_the_documentation_lead_to_a_race(browser: Browser, tmp_path: Path) -> None:
    made, served, opened = next(
        commands(block) for block in blocks(ROOT / "docs" / "cities.md") if "webbrowser" in block.text
    )
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    program = ["-m", "drone_env.cli"]
    subprocess.run([sys.executable, *program, *shlex.split(made)[1:]], cwd=tmp_path, check=True)
    plugins, _, *arguments = shlex.split(served)
    name, file = plugins.removeprefix("DRONE_ENV_").split("=")
    url = shlex.split(opened)[-1]
    with (
        serving(tmp_path / "data", (*program, *arguments), **{name: str(tmp_path / file)}) as server,
        Tabs(browser, server.url) as tabs,
    ):
        page = tabs.open(url.removeprefix("http://127.0.0.1:8000"))
        expect(page.locator("#standings tbody tr")).to_have_count(4)
        fly(page)
        expect(page.locator("#step-counter")).to_contain_text(re.compile("All parcels delivered|Step \\d{2,} of"))
        expect(page.get_by_role("link", name=CONTRIBUTORS)).to_be_visible(timeout=PATIENCE_MS)
        assert painted(page.locator(GROUND), *JOINED)
        assert tabs.unexpected() == []
