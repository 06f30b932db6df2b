"""The promises of the dashboard, in a real browser."""

import re
from collections.abc import Generator

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect

from tests.api.serving import Server
from tests.browser.flights import flown, frames
from tests.browser.stage import counter, expect_frame, fixed, fly, percent, pixels, results, view
from tests.browser.tabs import PATIENCE_MS, Tabs, needed_browser

expect.set_options(timeout=PATIENCE_MS)


@pytest.fixture(scope="module")
def browser() -> Generator[Browser, None, None]:
    with needed_browser() as running:
        yield running


@pytest.fixture
def page(browser: Browser, server: Server) -> Generator[Page, None, None]:
    """A page that does not go on to the next level by itself; what it complains of fails the test."""
    tabs = Tabs(browser, server.url)
    opened = tabs.open("/#specs")
    opened.evaluate("localStorage.setItem('drone-env-cycle', 'off')")
    yield opened
    tabs.close()
    assert tabs.unexpected() == []


@pytest.mark.feature("D1")
def test_d1_watch_the_network_fly(page: Page, server: Server) -> None:
    """Live map and telemetry; reset, start, pause, single steps of the neural network; request and training logs"""
    flight = frames(server.url, flown("hard", 14, "pathqnet"))
    page.goto("/?task=hard&seed=14&pilot=pathqnet")
    expect_frame(page, flight[0], 160)
    before = pixels(page.locator("#maps canvas").last)
    page.get_by_role("button", name="Step", exact=True).click()
    expect_frame(page, flight[1], 160)
    page.get_by_role("button", name="Go on", exact=True).click()
    expect(page.locator("#step-counter")).to_have_text(re.compile("Step [3-9] of 160"))
    assert pixels(page.locator("#maps canvas").last) != before
    page.get_by_role("button", name="Pause", exact=True).click()
    page.wait_for_timeout(200)
    at = counter(page)
    page.wait_for_timeout(400)
    assert counter(page) == at
    page.get_by_role("button", name="New map").click()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    (server.data / "train.log").write_text("episode=1 reward=0.25\n", encoding="utf-8")
    view(page, "Logs")
    expect(page.get_by_role("log", name="Requests")).to_contain_text("GET /tasks 200")
    expect(page.get_by_role("log", name="Training")).to_contain_text("episode=1 reward=0.25")


@pytest.mark.feature("D2")
@pytest.mark.parametrize(
    ("seed", "pilot", "heading", "efficiency"),
    # 3 of 60 steps: 75 + 15 * 57 / 60 + 10 * 57 / 60 = 98.75. Nothing delivered in 60 steps: 0.
    [(14, "greedy", "Mission accomplished", "98.8"), (0, "random", "Mission failed", "0.0")],
)
def test_d2_mission_results(page: Page, seed: int, pilot: str, heading: str, efficiency: str) -> None:
    """Mission Results pop up on success and on failure, with the efficiency: 75 % parcels, 15 % battery, 10 % steps"""
    page.goto(f"/?task=easy&seed={seed}&pilot={pilot}")
    fly(page)
    expect(results(page).get_by_role("heading", name=heading)).to_be_visible()
    expect(results(page).locator("#result-efficiency")).to_have_text(efficiency)


@pytest.mark.feature("D3")
def test_d3_easy_medium_hard_easy(page: Page) -> None:
    """The results lead on from Easy to Medium to Hard, and to Easy again"""
    page.goto("/?task=easy&seed=13&pilot=optimal")
    fly(page)
    for level in ("Medium", "Hard", "Easy"):
        results(page).get_by_role("button", name=f"Next: {level}").click()
        expect(page.get_by_role("radio", name=level, exact=True)).to_be_checked()
    results(page)


@pytest.mark.feature("D4")
def test_d4_technical_specifications(page: Page, server: Server) -> None:
    """Technical specifications: the three levels side by side, sizes and rewards as /tasks tells them"""
    levels = httpx.get(f"{server.url}/tasks").json()["tasks"][:3]
    view(page, "Specifications")
    table = page.get_by_role("table", name="Technical specifications of the Delivery levels")
    rows = table.evaluate("table => [...table.rows].map(row => [...row.cells].map(cell => cell.textContent))")
    shown = {row[0]: row[1:] for row in rows}
    assert shown["Grid"] == ["10 × 10", "14 × 14", "18 × 18"]
    assert shown["Parcels"] == [str(level["deliveries"]) for level in levels] == ["1", "3", "5"]
    assert shown["Steps at most"] == [str(level["max_steps"]) for level in levels]
    for row, name in (("Delivery", "r_delivery"), ("Step", "r_step"), ("Battery empty", "r_battery_dead")):
        assert shown[row] == [f"{level[name]:.2f}" for level in levels]


@pytest.mark.feature("D5")
def test_d5_analysis_on_completion(page: Page, server: Server) -> None:
    """The results show the analysis of all flights so far: mean reward, success trend, how often each action"""
    page.goto("/?task=medium&seed=11&pilot=greedy")
    fly(page)
    dialog = results(page)
    told = httpx.get(f"{server.url}/analyse/medium_delivery").json()
    assert told["episodes"] > 9, "the flight of this page is not among them"
    expect(dialog).to_contain_text(f"All {told['episodes']} flights of Medium here")
    expect(dialog).to_contain_text(f"Mean reward{fixed(told['average_reward'])}")
    expect(dialog).to_contain_text(
        re.compile(rf"Success trend[+\u2212]?{fixed(abs(told['success_trend']) * 100, 0)} %")
    )
    for action, share in told["action_distribution"].items():
        expect(dialog).to_contain_text(re.compile(rf"{action}\s*{percent(share)}"))
