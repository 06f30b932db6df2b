"""The end of a flight: the strip under the map, with what went wrong, what comes next and what is shared."""

import re

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.api.serving import Server
from tests.browser.flights import flown, frames, get, posted
from tests.browser.shown import expect_flying, expect_frame, expect_step, fixed, percent, points
from tests.browser.stage import copied, ended, fly, over
from tests.browser.tabs import Tabs

MORE = "Efficiency, and all flights of this task"


def expect_efficiency(page: Page, done: float, left: float) -> None:
    """The strip shows three shares, and their sum by weight."""
    group = page.get_by_role("group", name="Efficiency", exact=True)
    expect(group).to_contain_text(f"Efficiency {fixed(75 * done + 25 * left, 1)} of 100")
    expect(group.locator(".efficiency-share")).to_have_text(
        [f"{percent(share)} · weighs {weight} %" for share, weight in ((done, 75), (left, 15), (left, 10))]
    )


@pytest.mark.feature("D2")
@pytest.mark.feature("D5")
def test_success_shows_the_optimum_the_worst_move_efficiency_and_all_flights(page: Page, server: Server) -> None:
    # Chance delivers on this map, but late: it loses points.
    record = flown("easy", 82, "random")
    flight, annotation = frames(server, record), posted(server, "annotate", record)
    steps = len(record.actions)
    over(page, 82, "/?task=easy&seed=82&pilot=random")
    fly(page)
    strip = ended(page)
    score, optimum = points(annotation["score"]), points(annotation["optimal_score"])
    expect(strip.get_by_role("heading", name="Random: All parcels delivered.")).to_be_visible()
    expect(strip).to_contain_text(
        f"Score {score} of {optimum} possible, lost {points(annotation['regret'])}, 1 of 1 parcels, "
        f"{steps} steps, a best flight takes {annotation['optimal_steps']}."
    )
    expect(page.locator("#announcer")).to_have_text(f"All parcels delivered. Score {score}.")
    # Each of the 60 steps takes one of the 60 units of the battery.
    left = 1 - steps / 60
    for gauge, text in (("Battery", percent(left)), ("Steps", f"step {steps}")):
        expect(page.get_by_role("meter", name=gauge)).to_have_attribute("aria-valuetext", text)
    analysis = get(server, "analyse/easy")
    trend = analysis["success_trend"] * 100
    counted = strip.locator(".strip-analysis")
    expect(counted).to_contain_text(f"of Easy here: mean reward {fixed(analysis['average_reward'])}, success")
    for action, share in analysis["action_distribution"].items():
        expect(counted).to_contain_text(f"{action} {percent(share)}")
    strip.get_by_text(MORE).click()
    expect_efficiency(page, 1, left)
    expect(strip).to_contain_text(f"Success rate{percent(analysis['success_rate'])}")
    expect(strip).to_contain_text(f"Success trend{'+' if trend >= 0 else ''}{fixed(trend, 0)} points")
    worst = max(annotation["moves"], key=lambda move: move["regret"])
    seen = strip.get_by_role("button", name=re.compile("^Worst move"))
    expect(seen).to_have_text(f"Worst move: step {worst['step']}, {worst['action']}, lost {points(worst['regret'])}")
    seen.click()
    expect_frame(page, flight[worst["step"]], 60)
    # The visitor flies on from before it.
    strip.get_by_role("button", name="Try from step").click()
    expect_frame(page, flight[worst["step"] - 1], 60)
    expect(strip).to_be_hidden()
    expect(page).to_have_url(re.compile(f"fork={worst['step'] - 1}&of=random"))


@pytest.mark.feature("D2")
def test_failure_says_why_and_no_dialog_opens(page: Page) -> None:
    over(page, 0, "/?task=easy&seed=0&pilots=random,optimal")
    fly(page)
    strip = ended(page)
    expect(strip.get_by_role("heading", name="Random: Battery empty.")).to_be_visible()
    expect(strip).to_contain_text("0 of 1 parcels, 60 steps")
    expect(page.get_by_role("dialog")).to_be_hidden()
    strip.get_by_text(MORE).click()
    expect_efficiency(page, 0, 0)
    # With several flights, the strip is about the one that is selected.
    page.keyboard.press("2")
    expect(strip.get_by_role("heading", name="Optimal: All parcels delivered.")).to_be_visible()
    expect(strip).to_contain_text("nothing lost")
    expect(strip.get_by_role("button", name=re.compile("^Worst move"))).to_be_hidden()


@pytest.mark.feature("D3")
def test_from_easy_to_medium_to_hard_to_easy_and_nothing_starts_unasked(browser: Browser, server: Server) -> None:
    # In a context of its own: the clock is that of all its tabs.
    with Tabs(browser, server.url) as tabs:
        page = tabs.open(reduced_motion="reduce")
        page.clock.install()
        page.goto("/?task=easy&seed=14&pilot=optimal")
        for name, after, steps in (("Easy", "Medium", 60), ("Medium", "Hard", 100), ("Hard", "Easy", 160)):
            expect_step(page, 0, steps)
            page.clock.fast_forward(60_000)
            expect_step(page, 0, steps)
            fly(page)
            strip = ended(page)
            page.clock.fast_forward(60_000)
            expect(page.get_by_role("radio", name=name, exact=True)).to_be_checked()
            expect(page.get_by_role("dialog")).to_be_hidden()
            strip.get_by_role("button", name=f"Next: {after}").click()
        expect_step(page, 0, 60)
        expect_flying(page, "Optimal")
    assert tabs.unexpected() == []


def test_the_result_is_copied_as_a_line_and_the_link_shows_the_moment(page: Page, server: Server) -> None:
    over(page, 7, "/?task=easy&seed=7&pilots=human,pathqnet")
    expect_step(page, 0, 60)
    # Once there and back, and then to the parcel of this map.
    way = ["ArrowRight", "ArrowLeft", *["ArrowRight"] * 3, *["ArrowUp"] * 5]
    for key in way:
        page.keyboard.press(key)
    ended(page)
    best = len(flown("easy", 7, "optimal").actions)
    assert copied(page, "Copy result", "Result copied.") == (
        f"You {len(way)}, PathQNet {best}, optimum {best} · Easy, map 7 · {server.url}/?task=easy&seed=7"
    )
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    link = f"{server.url}/?task=easy&seed=7&pilots=human,pathqnet&step=1&flown=10"
    expect(page).to_have_url(link)
    assert copied(page, "Copy link to this moment", "Link copied.") == link
