"""The map: its layers, asked of the server once a moment, and cities, joined to blocks and seen from nearby."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Locator, Page, Request, Route, expect

from tests.api.serving import serving
from tests.browser.shown import changed, expect_step, offset, painted, pictures, points
from tests.browser.stage import ended, fly, map_number, press, show, until
from tests.browser.tabs import PATIENCE_MS, Tabs
from tests.browser.test_everybody import findings
from tests.docs.pages import ROOT, blocks
from tests.docs.shell import commands

GROUND, CELLS, AIR = range(3)
"""The canvases of a map: the city, the layers of its cells, what moves."""
LAYERS = {
    "Best from everywhere": ("v", CELLS),
    "Where the network errs": ("e", CELLS),
    "Range of the battery": ("b", CELLS),
    "A best flight": ("g", AIR),
}


def box(page: Page, name: str) -> Locator:
    return page.get_by_role("checkbox", name=name)


def test_each_layer_is_switched_by_box_and_key_and_the_server_is_asked_once_a_moment(page: Page) -> None:
    asked: list[int] = []
    held: list[Route] = []

    def note(request: Request) -> None:
        if request.url.endswith("/values"):
            asked.append(len(json.loads(request.post_data or "")["actions"]))

    best, cells = page.locator("#q-values tr.best"), page.locator("#boards .map-cells")
    show(page, "/?task=skyline_easy&seed=4711&pilot=greedy")
    expect_step(page, 0, 60)
    # Hidden before the end: it would show what is best.
    expect(box(page, "A best flight")).to_be_hidden()
    fly(page)
    ended(page)
    page.keyboard.press("Home")
    page.on("request", note)
    try:
        box(page, "A best flight").uncheck()
        bare = pictures(page)
        for name, (key, place) in LAYERS.items():
            box(page, name).check()
            if place == CELLS:
                expect(best.first).to_be_visible()
            assert changed(page, bare) == [place]
            page.keyboard.press(key)
            expect(box(page, name)).not_to_be_checked()
            assert changed(page, bare) == []
        assert asked == [0]
        # While the server computes, the values of the step before are dimmed, and the moves have none.
        page.keyboard.press("v")
        expect(best.first).to_be_visible()
        page.route("**/values", lambda route, _: held.append(route))
        press(page, "Step")
        until(page, lambda: bool(held))
        expect(best).to_have_count(0)
        expect(cells).to_have_css("opacity", "0.2")
        with page.expect_response("**/values") as answer:
            held[0].continue_()
        exact = answer.value.json()["q_values"]
        expect(cells).to_have_css("opacity", "1")
        for action, value in exact.items():
            row = page.locator(f"#q-values tr[data-action={action}]").get_by_role("cell")
            lost = max(exact.values()) - value
            expect(row).to_have_text([points(value), points(lost) if lost > 0.0005 else "0"])
        for key in ("Home", "ArrowRight"):
            page.keyboard.press(key)
            expect(best.first).to_be_visible()
        assert asked == [0, 1]
        # One request at a time, then the newest; the page draws each answer although the flight has moved on.
        held.clear()
        press(page, "Step")
        until(page, lambda: len(held) == 1)
        for _ in range(2):
            press(page, "Step")
        before = pictures(page)
        held[0].continue_()
        until(page, lambda: len(held) == 2)
        assert CELLS in changed(page, before)
        held[1].continue_()
        expect(cells).to_have_css("opacity", "1")
        assert asked == [0, 1, 2, 4]
    finally:
        page.unroute("**/values")
        page.remove_listener("request", note)
        box(page, "Best from everywhere").uncheck()
        box(page, "A best flight").check()


def test_only_where_there_is_something_to_be_shown(page: Page) -> None:
    ranges, thoughts = box(page, "Range of the battery"), box(page, "What the network thinks")
    show(page, "/?task=easy&seed=7&pilot=greedy")
    expect_step(page, 0, 60)
    # These maps have no pads.
    expect(ranges).to_be_hidden()
    expect(thoughts).to_be_checked()
    columns = page.get_by_role("table", name="Each move from here").get_by_role("columnheader")
    expect(columns).to_have_text(["Move", "Network", "Still possible", "Loses"])
    # The network that flies here has no values for single moves.
    show(page, "/?task=skyline_easy&seed=7&pilot=tournet")
    expect(thoughts).to_be_hidden()
    expect(columns).to_have_text(["Move", "Still possible", "Loses"])
    expect(page.locator("#confidence")).to_contain_text("No network values single moves here")
    with page.expect_response("**/values") as answer:
        ranges.check()
    chosen = page.get_by_role("combobox", name="The numbers are the units of battery left there")
    pads = [f"the pad at {pad['position']}, charged in full" for pad in answer.value.json()["pads"]]
    expect(chosen.locator("option")).to_have_text(["here", *pads])
    here = pictures(page)
    chosen.select_option(index=1)
    assert changed(page, here) == [CELLS]
    chosen.select_option("here")
    ranges.uncheck()
    expect(chosen).to_be_hidden()


def test_a_map_that_is_not_solved_says_so_and_a_refusal_is_told_once(page: Page, shared: Tabs) -> None:
    shared.expect("503")
    why = "the exact values of this map would take too much memory"
    refused: list[Route] = []

    def unsolved(route: Route) -> None:
        answer = route.fetch()
        known = answer.json()
        cells = known["cells"] | {"values": None, "best_actions": None, "disagree": None}
        nothing = dict.fromkeys(("optimum", "value", "regret", "q_values", "best_actions"))
        route.fulfill(json=known | nothing | {"unsolved": why, "cells": cells})

    def full(route: Route) -> None:
        refused.append(route)
        route.fulfill(status=503, json={"code": "busy", "detail": "too many requests are waiting"})

    show(page, "/?task=skyline_easy&seed=4712&pilot=greedy&step=3")
    expect(map_number(page)).to_have_value("4712")
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 3 of"))
    expect(page.locator("#lost")).not_to_have_text("–")
    before = pictures(page)
    page.route("**/values", unsolved)
    page.keyboard.press("v")
    expect(page.locator("#unsolved")).to_have_text(why)
    assert changed(page, before) == []
    page.keyboard.press("b")
    assert changed(page, before) == [CELLS], "the range of the battery is known all the same"
    page.keyboard.press("b")
    page.unroute("**/values")
    page.route("**/values", full)
    press(page, "Step back")
    expect(page.locator("#toasts").get_by_text("too many requests are waiting")).to_be_visible()
    for key in ("ArrowRight", "ArrowLeft"):
        page.keyboard.press(key)
        pictures(page)
    page.unroute("**/values")
    page.keyboard.press("v")
    assert len(refused) == 1


CONTRIBUTORS = "© OpenStreetMap contributors"
FIELD = "#boards .map-ground"
JOINED = ("--block-street", "--block-roof-1", "--block-wood", "--block-closed")


def test_a_city_is_joined_to_blocks_is_seen_from_nearby_and_says_whose_data_it_shows(page: Page) -> None:
    small = page.get_by_role("img", name="The whole map, with what is in sight")
    credit = page.get_by_role("link", name=CONTRIBUTORS)
    farther, nearer = (page.get_by_role("button", name=name) for name in ("Farther", "Nearer"))
    show(page, "/?task=city&seed=7&pilots=greedy")
    expect(credit).to_have_attribute("href", "https://www.openstreetmap.org/copyright")
    assert painted(page.locator(FIELD), *JOINED) == list(JOINED)
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
        ground = page.locator(FIELD).bounding_box()
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
    assert painted(page.locator(FIELD), *JOINED) == []


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
        assert painted(page.locator(FIELD), *JOINED)
        assert tabs.unexpected() == []
