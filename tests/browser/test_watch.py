"""Watching one pilot: instruments, messages, map, files; every pilot, by mouse, keys and touch."""

import csv
import json
import re

import httpx
import pytest
from playwright.sync_api import Page, expect

from drone_env.core.actions import Action
from drone_env.core.state_manager import Episode
from drone_env.episodes.record import record_of
from tests.api.serving import Server
from tests.browser.flights import flown, frames
from tests.browser.stage import counter, expect_frame, fastest, fixed, fly, pixels, results
from tests.browser.tabs import Tabs


def test_it_waits_for_start_and_shows_each_step_as_the_server_has_it(page: Page, server: Server) -> None:
    flight = frames(server.url, flown("medium", 7, "greedy"))
    page.goto("/?task=medium&seed=7&pilot=greedy")
    expect_frame(page, flight[0], 100)
    for frame in flight[1:4]:
        page.get_by_role("button", name="Step", exact=True).click()
        expect_frame(page, frame, 100)
        expect(page.locator("#events li").first).to_contain_text(frame["message"])
    page.get_by_text("Raw telemetry").click()
    shown = page.locator("#raw-frame")
    expect(shown).not_to_be_empty()
    raw = json.loads(shown.inner_text())
    known = {name: value for name, value in flight[3].items() if name not in ("value", "regret")}
    assert {name: raw[name] for name in known} == known


def test_start_pause_go_on_and_the_end(page: Page, server: Server) -> None:
    flight = frames(server.url, flown("medium", 8, "greedy"))
    page.goto("/?task=medium&seed=8&pilot=greedy")
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.locator("#step-counter")).to_have_text(re.compile("Step [2-9] of 100"))
    page.get_by_role("button", name="Pause", exact=True).click()
    expect(page.get_by_role("button", name="Go on", exact=True)).to_be_visible()
    page.wait_for_timeout(200)
    at = counter(page)
    page.wait_for_timeout(400)
    assert counter(page) == at < len(flight) - 1
    fastest(page)
    page.get_by_role("button", name="Go on", exact=True).click()
    results(page).get_by_role("button", name="Close").click()
    expect_frame(page, flight[-1], 100)
    expect(page.get_by_role("button", name="Fly again")).to_be_visible()


def test_the_map_is_crisp_and_moves(tabs: Tabs) -> None:
    page = tabs.open("/?task=hard&seed=7&pilot=greedy", device_scale_factor=2)
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    canvas = page.locator("#maps canvas")
    sizes = canvas.evaluate_all("all => all.map(c => [c.width, c.height, c.clientWidth, c.clientHeight])")
    assert sizes
    for width, height, shown_width, shown_height in sizes:
        # A canvas may be half a pixel wider than what `clientWidth` rounds.
        assert max(abs(width - 2 * shown_width), abs(height - 2 * shown_height)) <= 1
        assert min(shown_width, shown_height) > 300
    page.wait_for_timeout(200)
    before = [pixels(one) for one in canvas.all()]
    page.get_by_role("button", name="Step", exact=True).click()
    expect(page.locator("#step-counter")).to_have_text("Step 1 of 160")
    page.wait_for_timeout(600)
    terrain, flight = zip(before, [pixels(one) for one in canvas.all()], strict=True)
    assert terrain[0] == terrain[1]
    assert flight[0] != flight[1]


def test_csv_and_png_hold_the_flight(page: Page, server: Server) -> None:
    flight = frames(server.url, flown("easy", 9, "greedy"))
    page.goto("/?task=easy&seed=9&pilot=greedy")
    fly(page)
    results(page).get_by_role("button", name="Close").click()
    with page.expect_download() as table:
        page.get_by_role("button", name="CSV", exact=True).click()
    with table.value.path().open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["action"], float(row["reward"]), int(row["x"])) for row in rows[1:]] == [
        (frame["action"], frame["reward"], frame["x"]) for frame in flight[1:]
    ]
    assert {row["pilot"] for row in rows} == {"greedy"}
    with page.expect_download() as picture:
        page.get_by_role("button", name="Map PNG").click()
    assert picture.value.path().read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_the_network_shows_what_it_thinks(page: Page, server: Server) -> None:
    flight = frames(server.url, flown("hard", 7, "pathqnet"))
    page.goto("/?task=hard&seed=7&pilot=pathqnet")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    ranked = sorted(flight[0]["q_values"].items(), key=lambda pair: -pair[1])
    for action, value in ranked:
        row = page.locator("#q-values li").filter(has_text=action)
        expect(row).to_contain_text(fixed(value, 3))
    expect(page.locator("#confidence")).to_contain_text(f"{ranked[0][0]} leads {ranked[1][0]}")
    with_arrows = pixels(page.locator("#maps canvas").last)
    page.get_by_role("checkbox", name="Arrows on the map").uncheck()
    page.wait_for_timeout(200)
    assert pixels(page.locator("#maps canvas").last) != with_arrows
    page.get_by_role("button", name="Step", exact=True).click()
    expect_frame(page, flight[1], 160)
    assert flight[1]["action"] == ranked[0][0]


def test_every_pilot_flies_what_the_agent_of_that_name_flies(page: Page, server: Server) -> None:
    page.goto("/?task=easy&seed=31&pilot=random")
    for name, agent in (("Greedy", "greedy"), ("Optimal", "optimal"), ("PathQNet", "pathqnet"), ("Random", "random")):
        flight = frames(server.url, flown("easy", 31, agent))
        page.get_by_role("radio", name=name).check()
        page.get_by_role("spinbutton", name="Map").fill("31")
        expect_frame(page, flight[0], 60)
        fly(page)
        dialog = results(page)
        dialog.get_by_role("button", name="Close").click()
        expect_frame(page, flight[-1], 60)


def test_a_person_flies_by_pad_and_keys(page: Page, server: Server) -> None:
    expected = Episode("easy", "tiered")
    expected.reset(7)
    page.goto("/?task=easy&seed=7&pilot=greedy")
    page.get_by_role("radio", name="You").check()
    page.get_by_role("spinbutton", name="Map").fill("7")
    page.get_by_role("spinbutton", name="Map").press("Enter")
    pad = page.get_by_role("group", name="Fly")
    expect(pad).to_be_visible()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    for button, action in (("Up", Action.UP), ("Left", Action.LEFT), ("Wait", Action.WAIT)):
        pad.get_by_role("button", name=button, exact=True).click()
        expected.step(action)
        expect_frame(page, frames(server.url, record_of(expected, "me"))[-1], 60)
    page.locator("#step-counter").click()
    for key, action in (("ArrowDown", Action.DOWN), ("d", Action.RIGHT), (" ", Action.WAIT)):
        page.locator("body").press(key)
        expected.step(action)
        expect_frame(page, frames(server.url, record_of(expected, "me"))[-1], 60)


def test_a_person_flies_by_touch(tabs: Tabs) -> None:
    page = tabs.open("/?task=easy&seed=7&pilot=human", has_touch=True, viewport={"width": 390, "height": 844})
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    page.get_by_role("group", name="Fly").get_by_role("button", name="Down").tap()
    expect(page.locator("#step-counter")).to_have_text("Step 1 of 60")
    expect(page.locator("#events li").first).to_contain_text("1")


def test_a_link_opens_exactly_its_mission(tabs: Tabs, server: Server) -> None:
    page = tabs.open("/?task=hard&seed=7&pilot=greedy", permissions=["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="New map").click()
    expect(page.get_by_role("spinbutton", name="Map")).not_to_have_value("7")
    page.get_by_role("radio", name="Optimal").check()
    page.get_by_role("button", name="Copy link to this mission").click()
    link = page.evaluate("navigator.clipboard.readText()")
    seed = page.get_by_role("spinbutton", name="Map").input_value()
    other = tabs.open(link)
    expect(other.get_by_role("spinbutton", name="Map")).to_have_value(seed)
    expect(other.get_by_role("radio", name="Optimal")).to_be_checked()
    expect(other.get_by_role("radio", name="Hard", exact=True)).to_be_checked()
    fly(other)
    results(other)
    stored = httpx.get(f"{server.url}/episodes", params={"task": "hard", "agent": "optimal"}).json()["episodes"]
    assert stored[0]["seed"] == int(seed)


@pytest.mark.parametrize("task", ["easy", "skyline_easy"])
def test_the_legend_beside_the_map_shows_what_can_be_met_on_it(page: Page, server: Server, task: str) -> None:
    page.goto(f"/?task={task}&seed=7&pilot=greedy")
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 0 of "))
    legend = page.get_by_role("list", name="Legend").get_by_role("listitem")
    expect(legend.filter(has_text="Parcel").or_(legend.filter(has_text="Delivery"))).to_be_visible()
    expect(legend.filter(has_text="Pad")).to_be_visible(visible=task == "skyline_easy")
