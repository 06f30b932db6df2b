"""What can be laid on the map, asked of the server once a moment; and from where the map is seen."""

import json
import re

from playwright.sync_api import Locator, Page, Request, Route, expect

from tests.api.serving import Server
from tests.browser.flights import fill, flown
from tests.browser.shown import pictures, points
from tests.browser.stage import ended, fly, show, step
from tests.browser.tabs import Tabs

GROUND, CELLS, AIR = range(3)
"""The canvases of a map: the city, what is known of its cells, what moves."""


def changed(page: Page, before: list[str]) -> list[int]:
    """Which canvases no longer show what they did."""
    return [place for place, (now, then) in enumerate(zip(pictures(page), before, strict=True)) if now != then]


def box(page: Page, name: str) -> Locator:
    return page.get_by_role("checkbox", name=name)


def test_each_layer_is_switched_by_box_and_key_and_the_server_is_asked_once_a_moment(page: Page) -> None:
    asked: list[int] = []

    def note(request: Request) -> None:
        if request.url.endswith("/values"):
            asked.append(len(json.loads(request.post_data or "")["actions"]))

    show(page, "/?task=skyline_easy&seed=4711&pilot=greedy")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    # There is none before the end: it would tell what is best.
    expect(box(page, "A best flight")).to_be_hidden()
    fly(page)
    ended(page)
    page.keyboard.press("Home")
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 0 of"))
    page.on("request", note)
    try:
        layers = {
            "Best from everywhere": ("v", [CELLS]),
            "Where the network errs": ("e", [CELLS]),
            "Range of the battery": ("b", [CELLS]),
            "A best flight": ("g", [AIR]),
        }
        box(page, "A best flight").uncheck()
        bare = pictures(page)
        for name, (key, places) in layers.items():
            box(page, name).check()
            if places == [CELLS]:
                expect(page.locator("#q-values tr.best").first).to_be_visible()
            assert changed(page, bare) == places
            page.keyboard.press(key)
            expect(box(page, name)).not_to_be_checked()
            assert changed(page, bare) == []
            page.keyboard.press(key)
            expect(box(page, name)).to_be_checked()
            box(page, name).uncheck()
        assert asked == [0]
        # What each move leaves possible stands beside, of the moment that is looked at.
        page.keyboard.press("v")
        expect(page.locator("#q-values tr.best").first).to_be_visible()
        held: list[Route] = []
        page.route("**/values", lambda route, _: held.append(route))
        step(page)
        while not held:
            page.wait_for_timeout(20)
        expect(page.locator("#q-values tr.best")).to_have_count(0)
        # Until the answer is there, what lies on the map is of the moment before.
        cells = page.locator("#boards .map-cells")
        expect(cells).to_have_css("opacity", "0.2")
        with page.expect_response("**/values") as answer:
            held[0].continue_()
        exact = answer.value.json()["q_values"]
        page.unroute("**/values")
        expect(cells).to_have_css("opacity", "1")
        for action, value in exact.items():
            row = page.locator(f"#q-values tr[data-action={action}]").get_by_role("cell")
            expect(row.nth(0)).to_have_text(points(value))
            lost = max(exact.values()) - value
            expect(row.nth(1)).to_have_text(points(lost) if lost > 0.0005 else "0")
        there = pictures(page)
        page.keyboard.press("Home")
        expect(page.locator("#q-values tr.best").first).to_be_visible()
        page.keyboard.press("ArrowRight")
        expect(page.locator("#q-values tr.best").first).to_be_visible()
        assert changed(page, there) == []
        assert asked == [0, 1]
        # One question at a time, and after it the newest; each answer is drawn, though the flight has gone on.
        held.clear()
        page.route("**/values", lambda route, _: held.append(route))
        step(page)
        while not held:
            page.wait_for_timeout(20)
        for _ in range(2):
            step(page)
        before = pictures(page)
        held[0].continue_()
        while len(held) < 2:
            page.wait_for_timeout(20)
        assert CELLS in changed(page, before)
        held[1].continue_()
        page.unroute("**/values")
        expect(cells).to_have_css("opacity", "1")
        assert asked == [0, 1, 2, 4]
        page.keyboard.press("v")
        page.keyboard.press("End")
        expect(page.locator("#q-values td.num").nth(1)).to_have_text("–")
        assert asked == [0, 1, 2, 4]
    finally:
        page.remove_listener("request", note)
        for name in ("Best from everywhere", "Where the network errs", "Range of the battery"):
            box(page, name).uncheck()
        box(page, "A best flight").check()


def test_only_where_there_is_something_to_be_shown(page: Page) -> None:
    show(page, "/?task=easy&seed=7&pilot=greedy")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    # There are no pads on these maps.
    expect(box(page, "Range of the battery")).to_be_hidden()
    expect(page.locator("#lost")).not_to_have_text("–")  # what can be reached is painted when it is known
    before = pictures(page)
    page.keyboard.press("b")
    assert changed(page, before) == []
    expect(box(page, "What the network thinks")).to_be_checked()
    thoughts = page.get_by_role("table", name="Each move from here").get_by_role("columnheader")
    expect(thoughts).to_have_text(["Move", "Network", "Still possible", "Loses"])
    # Nor does the network that flies here value single moves.
    show(page, "/?task=skyline_easy&seed=7&pilot=tournet")
    expect(box(page, "What the network thinks")).to_be_hidden()
    expect(thoughts).to_have_text(["Move", "Still possible", "Loses"])
    expect(page.locator("#confidence")).to_contain_text("No network values single moves here")
    expect(box(page, "Range of the battery")).to_be_visible()
    expect(box(page, "Range of the battery")).not_to_be_checked()
    with page.expect_response("**/values") as answer:
        page.keyboard.press("b")
    pads = answer.value.json()["pads"]
    chosen = page.get_by_role("combobox", name="The numbers are the units of battery left there")
    expect(chosen.locator("option")).to_have_text(
        ["here", *(f"the pad at {pad['position']}, charged in full" for pad in pads)]
    )
    here = pictures(page)
    chosen.select_option(index=1)
    assert changed(page, here) == [CELLS]
    chosen.select_option("here")
    assert changed(page, here) == []
    page.keyboard.press("b")
    expect(chosen).to_be_hidden()


def test_a_map_that_is_not_solved_says_so_and_a_refusal_is_told_once(page: Page, shared: Tabs, server: Server) -> None:
    shared.expect("503")
    why = "the exact values of this map would take too much memory"

    def unsolved(route: Route) -> None:
        answer = route.fetch()
        told = answer.json()
        cells = told["cells"] | {"values": None, "best_actions": None, "disagree": None}
        nothing = dict.fromkeys(("optimum", "value", "regret", "q_values", "best_actions"))
        route.fulfill(json=told | nothing | {"unsolved": why, "cells": cells})

    refused: list[str] = []

    def full(route: Route) -> None:
        refused.append(route.request.url)
        route.fulfill(status=503, json={"code": "busy", "detail": "too many requests are waiting"})

    id_ = fill(server.data, [flown("skyline_easy", 4712, "greedy")])[0]
    show(page, f"/?episode={id_}")
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value("4712")
    pictures(page)  # drawn: what is said is of this flight
    ended(page)
    before = pictures(page)
    page.route("**/values", unsolved)
    page.keyboard.press("v")
    expect(page.locator("#unsolved")).to_have_text(why)
    assert changed(page, before) == []
    expect(page.locator("#q-values td.num").nth(1)).to_have_text("–")
    page.keyboard.press("b")
    assert changed(page, before) == [CELLS], "the range of the battery is known all the same"
    page.keyboard.press("b")
    page.unroute("**/values")
    page.route("**/values", full)
    try:
        step(page)
        expect(page.locator("#toasts").get_by_text("too many requests are waiting")).to_be_visible()
        expect(page.locator("#unsolved")).to_have_text("")
        for key in ("ArrowLeft", "ArrowRight"):
            page.keyboard.press(key)
            pictures(page)
        assert len(refused) == 1
    finally:
        page.unroute("**/values")
        page.keyboard.press("v")


def test_the_map_is_seen_from_nearer_follows_the_drone_and_is_moved(page: Page) -> None:
    def at() -> list[float]:
        """By how much the city has been moved, in pixels."""
        pictures(page)  # drawn
        moved = page.locator("#boards .map-ground").evaluate("canvas => canvas.style.transform")
        return [float(number) for number in re.findall(r"-?[0-9.]+", moved)]

    show(page, "/?task=hard&seed=7&pilot=pathqnet&step=30")
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 30 of"))
    tools = page.get_by_role("group", name="Map", exact=True)
    nearer, farther = (tools.get_by_role("button", name=name) for name in ("Nearer", "Farther"))
    follow = tools.get_by_role("button", name="Follow the drone")
    expect(farther).to_be_disabled()
    expect(follow).to_be_hidden()
    whole = pictures(page)
    assert at() == []
    nearer.click()
    page.keyboard.press("z")
    page.keyboard.press("z")
    assert changed(page, whole) == [GROUND, CELLS, AIR]
    expect(follow).to_be_hidden()
    # The drone is kept in sight.
    followed = at()
    page.keyboard.press("Home")
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 0 of"))
    assert at() != followed
    # A drag moves the map, and then it stays where it is.
    left, top = at()
    middle = page.locator("#boards").bounding_box()
    assert middle
    x, y = middle["x"] + middle["width"] / 2, middle["y"] + middle["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 30, y + 20)
    page.mouse.up()
    moved = at()
    assert abs(moved[0] - (left - 30)) <= 1
    assert abs(moved[1] - (top + 20)) <= 1
    page.keyboard.press("End")
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 30 of"))
    assert at() == moved
    follow.click()
    expect(follow).to_be_hidden()
    assert at() != moved
    for _ in range(3):
        page.keyboard.press("x")
    expect(farther).to_be_disabled()
    assert changed(page, whole) == []
    # A drag does not move a map that is seen as a whole, and another map is.
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 30, y + 20)
    page.mouse.up()
    assert changed(page, whole) == []
    nearer.click()
    page.get_by_role("button", name="New map").click()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    expect(farther).to_be_disabled()
