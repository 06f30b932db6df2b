"""Flying oneself: keys and pad, what is kept back, undo, and what asks before it destroys."""

import re
from typing import Any

from playwright.sync_api import Locator, Page, expect

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.results.record import record_of
from tests.api.serving import Server
from tests.browser.flights import frames
from tests.browser.shown import counter, expect_frame, pictures
from tests.browser.stage import along, ended, fly, over, pilot


def by_hand(server: Server, seed: int, actions: list[Action]) -> list[dict[str, Any]]:
    """What the server says of an easy flight with these actions."""
    episode = Episode("easy", "tiered", seed)
    for action in actions:
        episode.step(action)
    return frames(server, record_of(episode, "me"))


def to_the_parcel(seed: int) -> list[str]:
    """Keys that fly to the only parcel of an easy map, over whatever lies between."""
    episode = Episode("easy", "tiered", seed)
    (x, y), ((px, py, _),) = episode.position, episode.parcels
    across = ["ArrowRight" if px > x else "ArrowLeft"] * abs(px - x)
    return across + ["ArrowDown" if py > y else "ArrowUp"] * abs(py - y)


def stored(server: Server, seed: int) -> str:
    """Who has flown the newest flight of a map, as its record says."""
    known = server.client.get("/episodes", params={"task": "easy"}).json()["episodes"]
    newest = next(one["id"] for one in known if one["seed"] == seed)
    return server.client.get(f"/episodes/{newest}").json()["agent"]


def pad(page: Page) -> Locator:
    return page.get_by_role("group", name="Fly")


def test_arrows_fly_from_the_moment_on_at_which_you_is_chosen(page: Page, server: Server) -> None:
    by_pad = {"Up": Action.UP, "Left": Action.LEFT, "Wait": Action.WAIT}
    by_keys = {"ArrowDown": Action.DOWN, "d": Action.RIGHT, " ": Action.WAIT}
    actions = [Action.RIGHT, Action.UP, *by_pad.values(), *by_keys.values(), Action.DOWN, Action.LEFT, Action.UP]
    flight = iter(by_hand(server, 7, actions)[1:])
    over(page, 7, "/?task=easy&seed=7&pilot=greedy")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
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
    page.keyboard.press("ArrowUp")
    expect_frame(page, next(flight), 60)
    for name in by_pad:
        pad(page).get_by_role("button", name=name, exact=True).click()
        expect_frame(page, next(flight), 60)
    # Beside the buttons, which take the space bar for themselves.
    page.locator("#step-counter").click()
    for name in by_keys:
        page.keyboard.press(name)
        expect_frame(page, next(flight), 60)
    # After a look back the next move is flown where the flight is.
    page.get_by_role("button", name="First step").click()
    page.keyboard.press("ArrowDown")
    expect_frame(page, next(flight), 60)
    # A choice that was made by mouse does not take the arrows.
    page.get_by_role("radio", name="Easy", exact=True).click()
    page.keyboard.press("ArrowLeft")
    expect_frame(page, next(flight), 60)
    speed = page.get_by_role("combobox", name="Speed")
    speed.focus()
    speed.dispatch_event("pointerdown")
    speed.select_option("4")
    page.keyboard.press("ArrowUp")
    expect_frame(page, next(flight), 60)
    expect(speed).to_have_value("4")
    expect(page.get_by_role("radio", name="Easy", exact=True)).to_be_checked()
    expect(pilot(page, "You")).to_have_attribute("aria-pressed", "true")


def test_you_is_chosen_by_mouse_or_keyboard_and_beside_others_who_move_along(page: Page, server: Server) -> None:
    over(page, 12, "/?task=easy&seed=12&pilot=greedy")
    flown = by_hand(server, 12, [Action.RIGHT])[1]
    for chosen, key in ((pilot(page, "You"), ""), (pilot(page, "You"), "Enter"), (along(page, "Greedy"), " ")):
        expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
        chosen.press(key) if key else chosen.click()
        page.keyboard.press("ArrowRight")
        expect_frame(page, flown, 60)
        if key != " ":
            page.keyboard.press("r")
            page.get_by_role("button", name="Give it up").click()
    standings = page.get_by_role("table", name="Standings").locator("tbody tr")
    expect(standings).to_have_count(2)
    expect(standings.filter(has_text="Greedy").get_by_role("cell").first).to_have_text("1")
    expect(standings.filter(has_text="You")).to_have_class("selected")
    # Once the others have ended, nobody is left who flies by himself.
    fly(page, "Go on")
    expect(page.locator("#start")).to_be_hidden()
    expect(standings.filter(has_text="Greedy").get_by_role("cell").nth(1)).to_have_text("1/1")


def test_nothing_is_told_to_who_flies_unless_he_asks_and_then_the_record_says_so(page: Page, server: Server) -> None:
    over(page, 5, "/?task=easy&seed=5&pilot=human")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    way = to_the_parcel(5)[::-1]  # the last move is to the left, a key that looks back, too
    page.keyboard.press(way[0])
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 1 of 60"))
    thoughts = page.get_by_role("table", name="Each move from here")
    expect(thoughts.get_by_role("cell")).to_have_text(["\u2013"] * 10)
    for known in ("#possible", "#lost"):
        expect(page.locator(known)).to_have_text("\u2013")
    arrows = page.get_by_role("checkbox", name="What the network thinks")
    expect(arrows).to_be_hidden()
    expect(page.locator("#confidence")).to_have_text("What the moves are worth is kept back from who flies.")
    ask = page.get_by_role("button", name="Show what is possible")
    ask.click()
    expect(ask).to_be_hidden()
    expect(arrows).to_be_checked()
    expect(page.locator("#possible")).not_to_have_text("\u2013")
    expect(thoughts.locator("tr.best")).not_to_have_count(0)
    for key in way[1:]:
        page.keyboard.press(key)
    expect(ended(page)).to_contain_text("You: All parcels delivered.")
    assert stored(server, 5) == "human with values"
    # The next flight begins without.
    page.keyboard.press("r")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    expect(ask).to_be_visible()
    expect(page.locator("#possible")).to_have_text("\u2013")
    for key in way:
        page.keyboard.down(key)
    expect(ended(page)).to_contain_text("You: All parcels delivered.")
    assert stored(server, 5) == "human"
    # A key that is held on does not look back in the flight.
    page.keyboard.down(way[-1])
    pictures(page)
    assert counter(page) == len(way)
    for key in set(way):
        page.keyboard.up(key)
    # Nor does one wait more than there was to fly play it again, until the visitor does something else.
    page.keyboard.press(" ")
    pictures(page)
    assert counter(page) == len(way)
    page.keyboard.press("End")
    page.keyboard.press(" ")
    expect(page.get_by_role("button", name="Pause", exact=True)).to_be_visible()
    page.keyboard.down(" ")
    page.keyboard.down(" ")
    expect(page.get_by_role("button", name="Play", exact=True)).to_be_visible()
    page.keyboard.up(" ")


def test_a_move_is_taken_back_and_what_would_end_the_flight_asks_first(page: Page, server: Server) -> None:
    over(page, 8, "/?task=easy&seed=8&pilot=human")
    undo = page.get_by_role("button", name="Undo")
    expect(undo).to_be_disabled()
    way = to_the_parcel(8)
    moves = page.get_by_role("list", name="Moves").get_by_role("button")
    for key in (way[0], way[1], way[1]):
        page.keyboard.press(key)
    expect(moves).to_have_count(3)
    undo.click()
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 2 of 60"))
    page.keyboard.press("u")
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 1 of 60"))
    expect(moves).to_have_count(1)
    dialog = page.get_by_role("dialog")
    for key in ("r", "n"):
        page.keyboard.press(key)
        expect(dialog).to_contain_text("Give up your flight at step 1?")
        expect(dialog.get_by_role("button", name="Go on flying")).to_be_focused()
        page.keyboard.press("Escape")
        expect(dialog).to_be_hidden()
        expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 1 of 60"))
    rewards, number = page.get_by_role("combobox", name="Rewards"), page.get_by_role("spinbutton", name="Map")
    rewards.select_option("aligned")
    dialog.get_by_role("button", name="Go on flying").click()
    expect(rewards).to_have_value("tiered")
    number.fill("99")
    number.press("Enter")
    dialog.get_by_role("button", name="Go on flying").click()
    expect(number).to_have_value("8")
    pilot(page, "Greedy").click()
    dialog.get_by_role("button", name="Go on flying").click()
    expect(pilot(page, "You")).to_have_attribute("aria-pressed", "true")
    page.get_by_role("radio", name="Medium", exact=True).click()
    page.keyboard.press("Enter")
    expect(page.get_by_role("radio", name="Easy", exact=True)).to_be_checked()
    for key in way[1:]:
        page.keyboard.press(key)
    expect(ended(page)).to_contain_text("You: All parcels delivered.")
    assert stored(server, 8) == "human with undo"
    # What has ended is kept: nobody asks.
    page.keyboard.press("r")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    page.keyboard.press(way[0])
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 1 of 60"))
    page.keyboard.press("n")
    dialog.get_by_role("button", name="Give it up").click()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    expect(page.get_by_role("spinbutton", name="Map")).not_to_have_value(re.compile("^8?$"))
