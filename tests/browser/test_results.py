"""The Mission Results: what they say, and the next level."""

import re

import httpx
from playwright.sync_api import Page, expect

from tests.api.serving import Server
from tests.browser.flights import flown, frames
from tests.browser.stage import fixed, fly, percent, points, results
from tests.browser.tabs import Tabs


def test_success_shows_efficiency_the_optimum_and_the_analysis(page: Page, server: Server) -> None:
    last = frames(server.url, flown("medium", 11, "greedy"))[-1]
    page.goto("/?task=medium&seed=11&pilot=greedy")
    fly(page)
    dialog = results(page)
    expect(dialog.get_by_role("heading", name="Mission accomplished")).to_be_visible()
    stored = httpx.get(f"{server.url}/episodes", params={"task": "medium", "agent": "greedy"}).json()["episodes"]
    episode = next(one for one in stored if one["seed"] == 11)
    expect(dialog.locator("#result-efficiency")).to_have_text(fixed(last["efficiency"], 1))
    expect(dialog.locator("#result-score")).to_have_text(points(episode["score"]))
    expect(dialog).to_contain_text(f"optimum {points(episode['optimal_score'])}")
    expect(dialog.locator("#result-regret")).to_have_text(points(episode["regret"]))
    analysis = httpx.get(f"{server.url}/analyse/medium").json()
    expect(dialog).to_contain_text(percent(analysis["success_rate"]))
    expect(dialog).to_contain_text(fixed(analysis["average_reward"]))
    for action, share in analysis["action_distribution"].items():
        expect(dialog).to_contain_text(re.compile(rf"{action}\s*{percent(share)}"))


def test_failure_says_why(page: Page, server: Server) -> None:
    last = frames(server.url, flown("medium", 7, "random"))[-1]
    assert last["outcome"] == "battery_dead"
    page.goto("/?task=medium&seed=7&pilot=random")
    fly(page)
    dialog = results(page)
    expect(dialog.get_by_role("heading", name="Mission failed")).to_be_visible()
    expect(dialog).to_contain_text(f"Battery empty: {last['deliveries_done']} of 3 parcels in {last['step']} steps")
    expect(dialog.locator("#result-efficiency")).to_have_text(fixed(last["efficiency"], 1))


def test_look_at_the_flight_annotates_it(page: Page) -> None:
    page.goto("/?task=easy&seed=12&pilot=greedy")
    fly(page)
    results(page).get_by_role("button", name="Look at the flight").click()
    moves = page.locator("#side").get_by_role("list", name="Moves").get_by_role("button")
    expect(moves).to_have_count(len(flown("easy", 12, "greedy").actions))
    moves.nth(2).click()
    expect(page.locator("#step-counter")).to_contain_text("Step 3 of 60")


def test_it_goes_on_by_itself_until_that_is_switched_off(tabs: Tabs) -> None:
    page = tabs.open("/", go=False)
    page.clock.install()
    page.goto("/?task=easy&seed=14&pilot=optimal")
    fly(page)
    expect(results(page).locator("#countdown")).to_have_text(re.compile("Goes on in"))
    page.clock.run_for(10_000)
    expect(page.get_by_role("radio", name="Medium", exact=True)).to_be_checked()
    dialog = results(page)
    dialog.get_by_role("checkbox", name="Go on to the next level by itself").uncheck()
    expect(dialog.locator("#countdown")).to_have_text("")
    page.clock.run_for(10_000)
    dialog.get_by_role("button", name="Fly again").click()
    expect(results(page).get_by_role("button", name="Next: Hard")).to_be_visible()
    page.clock.run_for(10_000)
    expect(page.get_by_role("radio", name="Medium", exact=True)).to_be_checked()
