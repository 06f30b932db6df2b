"""A person flies: keys and pad, what is hidden from the person, undo, and questions before a flight is given up."""

import re

from playwright.sync_api import Locator, Page, expect

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.flights.record import record_of
from drone_env.planning.optimal import solve
from tests.api.serving import Server
from tests.browser.flights import frames, newest
from tests.browser.shown import at, box, counter, expect_flying, expect_frame, expect_step, pictures
from tests.browser.stage import (
    FASTEST,
    along,
    at_speed,
    choices,
    ended,
    keys,
    map_number,
    moves,
    over,
    pilot,
    press,
    slider,
    standings,
)
from tests.browser.test_several import KEYS

DASH = "\u2013"
"""Stands where the page shows no number."""


def to_the_parcel(seed: int) -> list[str]:
    """Keys that fly to the only parcel of an easy map, those to the left last."""
    return sorted((KEYS[action.name] for action in solve("easy", seed).actions), key=lambda key: key == "ArrowLeft")


def question(page: Page) -> Locator:
    return page.get_by_role("dialog").filter(has_text="Give up your flight at step 1?")


def test_arrows_fly_from_the_moment_on_at_which_you_is_chosen(page: Page, server: Server) -> None:
    flown = (Action.RIGHT, Action.LEFT, Action.DOWN, Action.RIGHT, Action.WAIT, Action.UP, Action.RIGHT)
    flight = iter(frames(server, record_of(Episode("easy", "tiered", 7).fly(flown), "me"))[1:])
    over(page, 7, "/?task=easy&seed=7&pilot=greedy")
    expect_step(page, 0, 60)
    # At once: the key comes before the server has answered.
    pilot(page, "You").evaluate(
        """button => {
            button.focus();
            button.click();
            const right = new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true });
            document.activeElement.dispatchEvent(right);
        }"""
    )
    expect_frame(page, next(flight), 60)
    page.keyboard.press("ArrowLeft")
    expect_frame(page, next(flight), 60)
    # Outside the buttons, which react to the space bar themselves.
    page.locator("#step-counter").click()
    for name in ("ArrowDown", "d", " ", "ArrowUp"):
        page.keyboard.press(name)
        expect_frame(page, next(flight), 60)
    # Nobody else flies, so there is no speed to choose.
    expect(page.locator("#speed")).to_be_hidden()
    # After a click on the graph, the arrows still fly.
    slider(page).click(position=at(slider(page), 0.99))
    page.keyboard.press("ArrowRight")
    expect_frame(page, next(flight), 60)


def test_others_move_along_with_a_person_who_can_still_win_all_and_end_by_themselves(page: Page) -> None:
    over(page, 20, "/?task=easy&seed=20&pilot=random")
    pilot(page, "You").press("Enter")
    expect_flying(page, "You")
    along(page, "Random").press(" ")
    other, person = (standings(page).filter(has_text=name) for name in ("Random", "You"))
    expect(page.locator(".hint")).to_contain_text("Press Start (Enter) to start the race.")
    press(page, "Step")
    expect(standings(page).get_by_role("rowheader")).to_have_text(["You", "Random"])
    expect(person.get_by_role("cell")).to_have_text(["0", "0/1", DASH, DASH])
    page.keyboard.press("ArrowRight")
    expect_step(page, 1, 60)
    expect(other.get_by_role("cell").first).to_have_text("2")
    expect(person).to_have_class("selected")
    # After a click on the speed, which is left as it was, the arrows still fly.
    speed = page.get_by_role("combobox", name="Speed")
    speed.dispatch_event("pointerdown")
    speed.focus()
    page.keyboard.press("ArrowLeft")
    expect_step(page, 2, 60, "LEFT")
    expect(speed).to_have_value("6")
    # Who has delivered ranks before a flight that could still score most. At last no pilot flies by itself.
    at_speed(page, FASTEST)
    page.locator("#step-counter").click()
    page.keyboard.press("Enter")
    expect(page.locator("#start")).to_be_hidden()
    expect(standings(page).get_by_role("rowheader")).to_have_text(["Random", "You"])


def test_values_are_hidden_from_a_person_until_asked_for(page: Page, server: Server) -> None:
    over(page, 5, "/?task=easy&seed=5&pilot=human")
    expect_step(page, 0, 60)
    way = to_the_parcel(5)  # the last move is to the left, a key that looks back, too
    page.keyboard.press(way[0])
    expect_step(page, 1, 60)
    thoughts, possible = page.get_by_role("table", name="Each move from here"), page.locator("[data-kind=possible]")
    expect(thoughts.get_by_role("cell")).to_have_text([DASH] * 10)
    expect(possible).to_have_count(0)
    arrows, ask = page.get_by_role("checkbox", name="Network values"), "Show values"
    expect(arrows).to_be_hidden()
    press(page, ask)
    expect(arrows).to_be_checked()
    expect(possible).not_to_have_count(0)
    expect(thoughts.locator("tr.best")).not_to_have_count(0)
    keys(page, *way[1:])
    expect(ended(page)).to_contain_text("You: All parcels delivered.")
    assert newest(server, 5)["agent"] == "human with values"
    page.keyboard.press("r")
    expect_step(page, 0, 60)
    for key in way:
        page.keyboard.down(key)
    ended(page)
    # A key that is still held does not look back in the flight.
    page.keyboard.down(way[-1])
    pictures(page)
    assert counter(page) == len(way)
    for key in set(way):
        page.keyboard.up(key)
    # One wait too many does not replay the flight.
    page.keyboard.press(" ")
    pictures(page)
    assert counter(page) == len(way)


def test_a_move_is_taken_back_and_what_would_end_the_flight_asks_first(page: Page, server: Server) -> None:
    over(page, 8, "/?task=easy&seed=8&pilot=human")
    undo, way = page.get_by_role("button", name="Undo"), to_the_parcel(8)
    expect(undo).to_be_disabled()
    keys(page, way[0], way[1], way[1])
    expect(moves(page)).to_have_count(3)
    expect(page.locator("#unlisted")).to_be_hidden()
    # Space is for the drone after a click, and for the button that the keyboard has reached.
    undo.click()
    page.keyboard.press(" ")
    expect_step(page, 3, 60, "WAIT")
    expect(page.locator("#unlisted")).to_be_visible()
    page.keyboard.press("u")
    undo.press(" ")
    expect_step(page, 1, 60)
    expect(moves(page)).to_have_count(1)
    choices(page)
    map_number(page).fill("99")
    for ask in (lambda: page.keyboard.press("Enter"), lambda: pilot(page, "Greedy").click()):
        ask()
        question(page).get_by_role("button", name="Keep flying").click()
        expect(question(page)).to_be_hidden()
        expect_step(page, 1, 60)
        expect(map_number(page)).to_have_value("8")
        expect_flying(page, "You")
    keys(page, *way[1:])
    expect(ended(page)).to_contain_text("You: All parcels delivered.")
    assert newest(server, 8)["agent"] == "human with undo"


def test_an_empty_battery_is_explained_and_the_flight_goes_on_from_where_it_could_be_won(page: Page) -> None:
    over(page, 7, "/?task=skyline_easy&seed=7&pilot=human")
    legend = page.get_by_role("list", name="Battery units of a step").get_by_role("listitem")
    expect(legend).to_have_text(["road 1", "tree 2", "building 3", "barricade closed", "pad +4", "any order"])
    told, side = page.locator(".hint strong"), page.locator(".side")
    expect(told).to_have_text("Fly with the arrow keys.", use_inner_text=True)
    side.evaluate("side => side.scrollTo(0, 999)")
    size = box(page, "#boards .map-air")
    keys(page, *["ArrowLeft", "ArrowRight"] * 6)
    expect(ended(page)).to_contain_text("The drone flew back and forth for 10 steps (2 to 11); then the battery was")
    # The loop is one entry of the list, which is marked during all its steps.
    loop = page.get_by_role("button", name="Steps 2 to 11, RIGHT, LEFT, 5 times: flew back and forth")
    expect(loop).to_have_text("2 to 11→ ← × 5??")
    expect(loop).to_have_attribute("aria-current", "step")
    expect(moves(page)).to_have_count(2)
    expect(told).to_be_hidden()
    for part in ("#results-title", "#again", "#undoes", "#start-over"):
        expect(page.locator(part)).to_be_in_viewport(ratio=1)
    assert box(page, "#boards .map-air") == size
    expect(page.locator("#next")).to_be_hidden()
    press(page, "Try again from step 6")
    expect_step(page, 6, 60, "RIGHT")
    expect(page).to_have_url(re.compile("pilot=human&of=human~~u&actions=LRLRLR$"))
    assert side.evaluate("side => side.scrollTop") == 0
    keys(page, *["ArrowLeft", "ArrowRight"] * 3)
    ended(page)
    at_speed(page, FASTEST)
    press(page, "Watch Tournet")
    expect_flying(page, "Tournet")
    ended(page)
    expect(page.locator("#watch, #start-over, #undoes").filter(visible=True)).to_have_count(0)
