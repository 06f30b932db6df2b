"""The end of a flight: the strip under the map, with what went wrong, what comes next and what is shared."""

import re
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.api.serving import Server
from tests.browser.flights import flown, frames, posted
from tests.browser.shown import expect_frame, fixed, percent, points
from tests.browser.stage import ended, fly, over, pilot
from tests.browser.tabs import Tabs

MORE = "Efficiency, and all flights of this task"


def expect_efficiency(page: Page, done: float, battery: float, steps: float) -> None:
    """The strip shows three shares, and their sum by weight."""
    weighed = {"Parcels delivered": (done, 75), "Battery left": (battery, 15), "Steps left": (steps, 10)}
    total = sum(share * weight for share, weight in weighed.values())
    group = page.get_by_role("group", name="Efficiency", exact=True)
    expect(group).to_contain_text(f"Efficiency {fixed(total, 1)} of 100")
    for bar, (name, (share, weight)) in zip(group.locator(".efficiency-part").all(), weighed.items(), strict=True):
        expect(bar.locator(".efficiency-name")).to_have_text(name, ignore_case=True)
        expect(bar.locator(".efficiency-share")).to_have_text(f"{percent(share)} · weighs {weight} %")


@pytest.mark.feature("D2")
@pytest.mark.feature("D5")
def test_success_shows_the_optimum_the_worst_move_efficiency_and_all_flights(page: Page, server: Server) -> None:
    # Chance delivers on this map, but late: it gives something away.
    record = flown("easy", 82, "random")
    flight = frames(server, record)
    last, annotation = flight[-1], posted(server, "annotate", record)
    over(page, 82, "/?task=easy&seed=82&pilot=random")
    fly(page)
    strip = ended(page)
    expect(strip.get_by_role("heading", name="Random: All parcels delivered.")).to_be_visible()
    assert annotation["regret"] > 0
    score, optimum = points(annotation["score"]), points(annotation["optimal_score"])
    expect(strip).to_contain_text(
        f"Score {score} of {optimum} possible, lost {points(annotation['regret'])}, 1 of 1 parcels, "
        f"{last['step']} steps, a best flight takes {annotation['optimal_steps']}."
    )
    expect(page.locator("#announcer")).to_have_text(f"All parcels delivered. Score {score}.")
    for gauge, told in (("Battery", percent(1 - last["step"] / 60)), ("Steps", f"step {last['step']}")):
        expect(page.get_by_role("meter", name=gauge)).to_have_attribute("aria-valuetext", told)
    # Without a click: what all flights of the task come to.
    analysis = server.client.get("/analyse/easy").json()
    counted = strip.locator(".strip-analysis")
    expect(counted).to_contain_text(f"of Easy here: mean reward {fixed(analysis['average_reward'])}, success")
    for action, share in analysis["action_distribution"].items():
        expect(counted).to_contain_text(f"{action} {percent(share)}")
    strip.get_by_text(MORE).click()
    # Each of the 60 steps takes one of the 60 units of the battery.
    left = 1 - last["step"] / 60
    expect_efficiency(page, 1, left, left)
    trend = analysis["success_trend"] * 100
    expect(strip).to_contain_text(f"All {analysis['episodes']} flights of Easy here")
    expect(strip).to_contain_text(f"Success rate{percent(analysis['success_rate'])}")
    expect(strip).to_contain_text(f"Mean reward{fixed(analysis['average_reward'])}")
    expect(strip).to_contain_text(f"Success trend{'+' if trend >= 0 else ''}{fixed(trend, 0)} points")
    for action, share in analysis["action_distribution"].items():
        expect(strip).to_contain_text(f"{action} {percent(share)}")
    moves: list[dict[str, Any]] = annotation["moves"]
    worst = max(moves, key=lambda move: move["regret"])
    seen = strip.get_by_role("button", name=re.compile("^Worst move"))
    expect(seen).to_have_text(f"Worst move: step {worst['step']}, {worst['action']}, lost {points(worst['regret'])}")
    seen.click()
    expect_frame(page, flight[worst["step"]], 60)
    # From before it, the visitor flies on beside it.
    strip.get_by_role("button", name="Try from step").click()
    expect(page.get_by_role("table", name="Standings").locator("tr.selected")).to_contain_text("You")
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
    expect_efficiency(page, 0, 0, 0)
    # Of several flights it tells of the one that is looked at.
    page.keyboard.press("2")
    expect(strip.get_by_role("heading", name="Optimal: All parcels delivered.")).to_be_visible()
    expect(strip).to_contain_text("nothing lost")
    expect(strip.get_by_role("button", name=re.compile("^Worst move"))).to_be_hidden()
    expect(strip.get_by_role("group", name="Efficiency", exact=True)).to_be_hidden()


@pytest.mark.feature("D3")
def test_from_easy_to_medium_to_hard_to_easy_and_nothing_starts_unasked(browser: Browser, server: Server) -> None:
    # In a window of its own: the clock is that of all its tabs.
    with Tabs(browser, server.url) as tabs:
        page = tabs.open(go=False, reduced_motion="reduce")
        page.clock.install()
        page.goto("/?task=easy&seed=14&pilot=optimal")
        for name, after in (("Easy", "Medium"), ("Medium", "Hard"), ("Hard", "Easy")):
            expect(page.get_by_role("radio", name=name, exact=True)).to_be_checked()
            expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 0 of "))
            page.clock.fast_forward(60_000)
            expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 0 of "))
            fly(page)
            strip = ended(page)
            page.clock.fast_forward(60_000)
            expect(page.get_by_role("radio", name=name, exact=True)).to_be_checked()
            expect(page.get_by_role("dialog")).to_be_hidden()
            strip.get_by_role("button", name=f"Next: {after}").click()
        expect(page.get_by_role("radio", name="Easy", exact=True)).to_be_checked()
        expect(pilot(page, "Optimal")).to_have_attribute("aria-pressed", "true")
        expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    assert tabs.unexpected() == []


def test_the_result_is_copied_as_a_line_and_the_link_shows_the_moment(page: Page, server: Server) -> None:
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    over(page, 7, "/?task=easy&seed=7&pilots=human,pathqnet")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    # Once there and back, and then to the parcel of this map.
    way = ["ArrowRight", "ArrowLeft", *["ArrowRight"] * 3, *["ArrowUp"] * 5]
    for key in way:
        page.keyboard.press(key)
    expect(page.locator("#step-counter")).to_have_text(re.compile(f"^Step {len(way)} of"))
    strip = ended(page)
    strip.get_by_role("button", name="Copy result").click()
    expect(page.locator("#toasts")).to_contain_text("Result copied.")
    line = page.evaluate("navigator.clipboard.readText()")
    network, best = len(flown("easy", 7, "pathqnet").actions), len(flown("easy", 7, "optimal").actions)
    assert network == best == len(way) - 2
    expected = f"You {len(way)}, PathQNet {network}, optimum {best} · Easy, map 7 · {server.url}/?task=easy&seed=7"
    assert line == expected
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    expect(page).to_have_url(re.compile("step=1&flown=10$"))
    strip.get_by_role("button", name="Copy link").click()
    expect(page.locator("#toasts")).to_contain_text("Link copied.")
    link = page.evaluate("navigator.clipboard.readText()")
    assert link == f"{server.url}/?task=easy&seed=7&pilots=human,pathqnet&step=1&flown=10"
