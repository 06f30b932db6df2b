"""One pilot: instruments, transport, graph, thoughts, files and the map."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, Route, expect

from drone_env.flights.record import parse_record
from tests.api.serving import Server
from tests.browser.flights import flown, frames
from tests.browser.shown import (
    counter,
    expect_flying,
    expect_frame,
    expect_step,
    fixed,
    painted,
)
from tests.browser.stage import at_speed, choices, ended, enter, fly, map_number, over, pilot, press, until


@pytest.mark.feature("D1")
def test_each_step_is_as_the_server_has_it_from_start_to_pause_the_end_its_record_reset_and_a_new_map(
    page: Page, server: Server
) -> None:
    record = flown("medium", 7, "greedy")
    flight = frames(server, record)
    over(page, 7, "/?task=medium&seed=7&pilot=greedy")
    expect_frame(page, flight[0], 100)
    press(page, "Step")
    expect_frame(page, flight[1], 100)
    expect(page.locator("#move-detail")).to_contain_text(flight[1]["message"])
    at_speed(page, "2")  # slow enough that it does not end before the pause
    press(page, "Resume")
    expect(page.get_by_role("button", name="Step", exact=True)).to_be_disabled()
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step ([2-9]|[1-9][0-9]) of 100"))
    press(page, "Pause")
    expect(page.get_by_role("button", name="Resume", exact=True)).to_be_visible()
    at = counter(page)
    assert at < len(flight) - 1
    press(page, "Step")
    expect_frame(page, flight[at + 1], 100)
    # There is no record before the end.
    expect(page.get_by_role("button", name="Save record", exact=True)).to_be_disabled()
    fly(page, "Resume")
    ended(page)
    with page.expect_download() as saved:
        press(page, "Save record")
    assert saved.value.suggested_filename == "medium-7-greedy.json"
    assert parse_record(saved.value.path().read_bytes(), "it") == record
    # The keys still work after a click on a button that then is disabled and has the focus.
    press(page, "First step")
    page.keyboard.press("ArrowRight")
    expect_frame(page, flight[1], 100)
    page.locator("#step-counter").click()
    page.keyboard.press("Space")
    expect_frame(page, flight[-1], 100)
    press(page, "Reset")
    expect_frame(page, flight[0], 100)
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_visible()
    press(page, "New map")
    expect(map_number(page)).not_to_have_value(re.compile("^7?$"))
    expect_step(page, 0, 100)


@pytest.mark.feature("D1")
def test_the_network_shows_what_it_thinks_of_each_move(page: Page, server: Server) -> None:
    flight = frames(server, flown("hard", 7, "pathqnet"))
    over(page, 7, "/?task=hard&seed=7&pilot=pathqnet")
    expect_frame(page, flight[0], 160)
    press(page, "Step")
    expect_frame(page, flight[1], 160)
    until(page, lambda: painted(page.locator("#boards .map-air"), "--network") == ["--network"])
    thoughts = page.get_by_role("table", name="Each move from here")
    ranked = sorted(flight[1]["q_values"].items(), key=lambda pair: -pair[1])
    for action, value in ranked:
        expect(thoughts.locator(f"tr[data-action={action}]").get_by_role("cell").first).to_have_text(fixed(value, 3))
    expect(thoughts.locator("tr:has(td.best)")).to_contain_text([ranked[0][0]])


def test_the_answer_to_an_older_choice_does_not_undo_a_newer_one(beside: Callable[..., Page]) -> None:
    page, held = beside(), list[Route]()
    page.route("**/flights", lambda route, _: held.append(route))
    page.goto("/?task=easy&seed=3&pilot=greedy")
    until(page, lambda: bool(held))
    pilot(page, "You").click()
    choices(page)
    enter(map_number(page), "7")
    until(page, lambda: len(held) == 3)
    page.keyboard.press("Escape")
    for route in (held[0], held[2], held[1]):
        page.keyboard.press("ArrowUp")
        with page.expect_response("**/flights"):
            route.continue_()
        expect_flying(page, "You")
        expect(map_number(page)).to_have_value("7")
    # The moves until the answer, and those after it.
    expect_step(page, 3, 60)
