"""The Mission Results: what they say, and the next level."""

import re

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect

from tests.api.serving import Server
from tests.browser.flights import flown, frames
from tests.browser.stage import fixed, fly, percent, points, results
from tests.browser.tabs import Tabs


def expect_efficiency(page: Page, done: float, battery: float, steps: float) -> None:
    """The results show three shares, and their sum by weight."""
    weighed = {"Parcels delivered": (done, 75), "Battery left": (battery, 15), "Steps left": (steps, 10)}
    expect(page.locator("#result-efficiency")).to_have_text(
        fixed(sum(share * weight for share, weight in weighed.values()), 1)
    )
    bars = page.get_by_role("group", name="Efficiency").locator(".efficiency-part")
    for bar, (name, (share, weight)) in zip(bars.all(), weighed.items(), strict=True):
        expect(bar.locator(".efficiency-name")).to_have_text(name, ignore_case=True)
        expect(bar.locator(".efficiency-share")).to_have_text(f"{percent(share)} · weighs {weight} %")


@pytest.mark.feature("D2")
@pytest.mark.feature("D5")
def test_success_shows_efficiency_the_optimum_the_analysis_and_leads_to_the_moves(page: Page, server: Server) -> None:
    # Chance delivers on this map, but late: it gives something away.
    last = frames(server.url, flown("easy", 82, "random"))[-1]
    page.goto("/?task=easy&seed=82&pilot=random")
    fly(page)
    dialog = results(page)
    expect(dialog.get_by_role("heading", name="Mission accomplished")).to_be_visible()
    stored = httpx.get(f"{server.url}/episodes", params={"task": "easy", "agent": "random"}).json()["episodes"]
    episode = next(one for one in stored if one["seed"] == 82)
    # Each of the 60 steps takes one of the 60 units of the battery.
    left = 1 - last["step"] / 60
    expect_efficiency(page, 1, left, left)
    expect(dialog.locator("#result-score")).to_have_text(points(episode["score"]))
    expect(dialog).to_contain_text(f"optimum {points(episode['optimal_score'])}")
    assert episode["regret"] > 0
    expect(dialog.locator("#result-regret")).to_have_text(points(episode["regret"]))
    analysis = httpx.get(f"{server.url}/analyse/easy").json()
    expect(dialog).to_contain_text(f"All {analysis['episodes']} flights of Easy here")
    expect(dialog).to_contain_text(f"Success rate{percent(analysis['success_rate'])}")
    expect(dialog).to_contain_text(f"Mean reward{fixed(analysis['average_reward'])}")
    trend = analysis["success_trend"] * 100
    expect(dialog).to_contain_text(f"Success trend{'+' if trend >= 0 else ''}{fixed(trend, 0)} %")
    for action, share in analysis["action_distribution"].items():
        expect(dialog).to_contain_text(re.compile(rf"{action}\s*{percent(share)}"))
    said = f"Mission accomplished. Score {points(episode['score'])}, efficiency {fixed(last['efficiency'], 1)}."
    expect(page.locator("#announcer")).to_have_text(said)
    dialog.get_by_role("button", name="Look at the flight").click()
    moves = page.locator("#side").get_by_role("list", name="Moves").get_by_role("button")
    expect(moves).to_have_count(last["step"])
    expect(page.locator("#maps canvas[role=img]")).to_have_attribute(
        "aria-label", re.compile("^City map of Easy, 10 by 10 cells, map 82, 1 parcel")
    )
    for gauge, told in (("Battery", percent(left)), ("Steps", f"step {last['step']}")):
        expect(page.get_by_role("meter", name=gauge)).to_have_attribute("aria-valuetext", told)
    moves.nth(2).click()
    expect(page.locator("#step-counter")).to_have_text("Step 3 of 60")


@pytest.mark.feature("D2")
def test_failure_says_why(page: Page) -> None:
    page.goto("/?task=easy&seed=0&pilot=random")
    fly(page)
    dialog = results(page)
    expect(dialog.get_by_role("heading", name="Mission failed")).to_be_visible()
    expect(dialog).to_contain_text("Battery empty: 0 of 1 parcels in 60 steps")
    expect_efficiency(page, 0, 0, 0)


@pytest.mark.feature("D3")
def test_from_easy_to_medium_to_hard_to_easy_by_itself_until_that_is_switched_off(
    browser: Browser, server: Server
) -> None:
    # A browser of its own: the clock is that of all its tabs.
    with Tabs(browser, server.url) as tabs:
        page = tabs.open(go=False, reduced_motion="reduce")
        page.clock.install()
        page.goto("/?task=easy&seed=14&pilot=optimal")
        fly_on(page)
    assert tabs.unexpected() == []


def fly_on(page: Page) -> None:
    fly(page)
    expect(results(page).locator("#countdown")).to_have_text(re.compile("Goes on in"))
    page.clock.run_for(10_000)
    expect(page.get_by_role("radio", name="Medium", exact=True)).to_be_checked()
    dialog = results(page)
    dialog.get_by_role("checkbox", name="Go on to the next level by itself").uncheck()
    expect(dialog.locator("#countdown")).to_have_text("")
    page.clock.run_for(10_000)
    # At once: it would come again after the next flight.
    assert dialog.is_visible()
    dialog.get_by_role("button", name="Next: Hard").click()
    expect(page.get_by_role("radio", name="Hard", exact=True)).to_be_checked()
    expect(results(page).get_by_role("button", name="Next: Easy")).to_be_visible()
    page.clock.run_for(10_000)
    assert dialog.is_visible()
    dialog.get_by_role("button", name="Next: Easy").click()
    expect(page.get_by_role("radio", name="Easy", exact=True)).to_be_checked()
