"""Watching one pilot: instruments, messages, map, files; every pilot, by mouse, keys and touch."""

import csv
import json
import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, WebSocketRoute, expect

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.episodes.record import record_of
from tests.api.serving import Server
from tests.browser.flights import flown, frames
from tests.browser.stage import counter, expect_frame, fastest, fixed, fly, pictures, results, slow


def test_it_waits_for_start_shows_each_step_as_the_server_has_it_and_saves_them(page: Page, server: Server) -> None:
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
    with page.expect_download() as table:
        page.get_by_role("button", name="CSV", exact=True).click()
    with table.value.path().open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["step"], row["action"], row["reward"], row["x"], row["message"]) for row in rows[1:]] == [
        tuple(str(frame[name]) for name in ("step", "action", "reward", "x", "message")) for frame in flight[1:4]
    ]
    assert {(row["pilot"], row["task"], row["seed"]) for row in rows} == {("greedy", "medium_delivery", "7")}
    with page.expect_download() as picture:
        page.get_by_role("button", name="Map PNG").click()
    assert picture.value.path().read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.feature("D1")
def test_start_pause_a_step_go_on_the_end_and_a_new_map(page: Page, server: Server) -> None:
    flight = frames(server.url, flown("medium", 8, "greedy"))
    with page.expect_websocket() as socket:
        page.goto("/?task=medium&seed=8&pilot=greedy")
    slow(page)
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.get_by_role("button", name="Step", exact=True)).to_be_disabled()
    expect(page.locator("#step-counter")).to_have_text(re.compile("Step ([2-9]|[1-9][0-9]) of 100"))
    with socket.value.expect_event("framereceived", says_paused):
        page.get_by_role("button", name="Pause", exact=True).click()
    expect(page.get_by_role("button", name="Go on", exact=True)).to_be_visible()
    # The server flies nothing after it has said that it paused: the next step is the one that is asked for.
    at = counter(page)
    assert at < len(flight) - 1
    page.get_by_role("button", name="Step", exact=True).click()
    expect_frame(page, flight[at + 1], 100)
    fastest(page)
    page.get_by_role("button", name="Go on", exact=True).click()
    results(page).get_by_role("button", name="Close").click()
    expect_frame(page, flight[-1], 100)
    expect(page.get_by_role("button", name="Fly again")).to_be_visible()
    page.get_by_role("button", name="New map").click()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 100")
    expect(page.get_by_role("spinbutton", name="Map")).not_to_have_value("8")


def says_paused(frame: str | bytes) -> bool:
    message = json.loads(frame)
    return message["type"] == "playing" and not message["playing"]


@pytest.mark.feature("D1")
def test_the_network_shows_what_it_thinks(page: Page, server: Server) -> None:
    flight = frames(server.url, flown("hard", 7, "pathqnet"))
    page.goto("/?task=hard&seed=7&pilot=pathqnet")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    ranked = sorted(flight[0]["q_values"].items(), key=lambda pair: -pair[1])
    for action, value in ranked:
        row = page.locator("#q-values li").filter(has_text=action)
        expect(row).to_contain_text(fixed(value, 3))
    lead = fixed(ranked[0][1] - ranked[1][1], 3)
    expect(page.locator("#confidence")).to_have_text(f"{ranked[0][0]} leads {ranked[1][0]} by {lead}")
    expect(page.locator("#q-values li.best")).to_contain_text(ranked[0][0])
    city, with_arrows = pictures(page)
    page.get_by_role("checkbox", name="Arrows on the map").uncheck()
    same, without = pictures(page)
    assert same == city
    assert without != with_arrows
    page.get_by_role("button", name="Step", exact=True).click()
    expect_frame(page, flight[1], 160)
    same, moved = pictures(page)
    assert same == city
    assert moved != without
    assert flight[1]["action"] == ranked[0][0]


def test_a_map_that_is_typed_is_flown(page: Page, server: Server) -> None:
    page.goto("/?task=easy&seed=3&pilot=greedy")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    page.get_by_role("spinbutton", name="Map").fill("7")
    page.get_by_role("spinbutton", name="Map").press("Enter")
    fly(page)
    expect_frame(page, frames(server.url, flown("easy", 7, "greedy"))[-1], 60)


def test_the_answer_to_an_older_choice_does_not_undo_a_newer_one(beside: Callable[[str], Page]) -> None:
    page, held = beside(""), list[Callable[[], None]]()

    def hold_the_missions(socket: WebSocketRoute) -> None:
        server = socket.connect_to_server()

        def answer(text: str | bytes) -> None:
            if json.loads(text)["type"] == "flights":
                held.append(lambda: socket.send(text))
            else:
                socket.send(text)

        server.on_message(answer)

    def answer_the_next() -> None:
        while not held:
            page.wait_for_timeout(20)
        held.pop(0)()

    page.route_web_socket("**/live", hold_the_missions)
    page.goto("/?task=easy&seed=3&pilot=greedy")
    you, number = page.get_by_role("radio", name="You"), page.get_by_role("spinbutton", name="Map")
    you.check()
    number.fill("7")
    number.press("Enter")
    for _ in range(2):
        answer_the_next()
        expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
        expect(you).to_be_checked()
        expect(number).to_have_value("7")
    answer_the_next()
    page.get_by_role("group", name="Fly").get_by_role("button", name="Wait", exact=True).click()
    expect(page.locator("#step-counter")).to_have_text("Step 1 of 60")


def test_a_person_flies_by_pad_and_keys(page: Page, server: Server) -> None:
    expected = Episode("easy", "tiered")
    expected.reset(7)
    page.goto("/?task=easy&seed=7&pilot=greedy")
    by_pad = {"Up": Action.UP, "Left": Action.LEFT, "Wait": Action.WAIT}
    by_keys = {"ArrowDown": Action.DOWN, "d": Action.RIGHT, " ": Action.WAIT}
    for action in (Action.RIGHT, *by_pad.values(), *by_keys.values()):
        expected.step(action)
    flight = iter(frames(server.url, record_of(expected, "me"))[1:])
    # The keys fly from the moment on at which the pilot is chosen.
    page.get_by_role("radio", name="You").click()
    expect(page.get_by_role("group", name="Fly")).to_be_visible()
    page.keyboard.press("ArrowRight")
    expect_frame(page, next(flight), 60)
    for name in by_pad:
        page.get_by_role("group", name="Fly").get_by_role("button", name=name, exact=True).click()
        expect_frame(page, next(flight), 60)
    # Beside the buttons, which take the space bar for themselves.
    page.locator("#step-counter").click()
    for name in by_keys:
        page.keyboard.press(name)
        expect_frame(page, next(flight), 60)


def test_the_legend_beside_the_map_shows_what_can_be_met_on_it(page: Page) -> None:
    page.goto("/?task=easy&seed=7&pilot=greedy")
    legend = page.get_by_role("list", name="Legend").get_by_role("listitem")
    expect(legend.filter(has_text="Parcel").or_(legend.filter(has_text="Delivery"))).to_be_visible()
    expect(legend.filter(has_text="Pad")).to_be_hidden()
    expect(page.locator("#target")).to_be_visible()
    expect(page.locator("#below")).to_be_hidden()
    page.get_by_role("radio", name="Skyline Easy").check()
    expect(legend.filter(has_text="Pad")).to_be_visible()
    expect(page.locator("#below")).to_have_text("Road")


def test_on_a_pad_it_is_said_that_waiting_charges(page: Page, server: Server) -> None:
    # The first map on whose best flight the drone comes to one.
    flights = ((seed, frames(server.url, flown("skyline_easy", seed, "optimal"))) for seed in range(100))
    seed, flight = next((seed, all_) for seed, all_ in flights if any(frame["cell_below"] == "pad" for frame in all_))
    page.goto(f"/?task=skyline_easy&seed={seed}&pilot=optimal")
    for step, frame in enumerate(flight):
        expect(page.locator("#step-counter")).to_have_text(f"Step {step} of 60")
        if frame["cell_below"] == "pad":
            break
        expect(page.locator("#below")).to_have_text(frame["cell_below"].title())
        page.get_by_role("button", name="Step", exact=True).click()
    expect(page.locator("#below")).to_have_text("Pad: WAIT charges")
