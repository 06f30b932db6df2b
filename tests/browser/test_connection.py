"""Two tabs at once, a server that is killed and comes back, a server that wants a token."""

import re
from pathlib import Path

from playwright.sync_api import Browser, expect

from drone_env.episodes.store import Store
from tests.api.serving import Server, serving
from tests.browser.flights import flown, frames
from tests.browser.stage import counter, expect_frame, fastest, fly, results
from tests.browser.tabs import Tabs
from tests.tools import reserved_port

TOKEN = "let-me-in"


def test_two_tabs_fly_two_missions_at_once(tabs: Tabs, server: Server) -> None:
    one = tabs.open("/?task=medium&seed=51&pilot=greedy")
    other = tabs.open("/?task=hard&seed=52&pilot=optimal", beside=one)
    for page in (one, other):
        fastest(page)
    one.get_by_role("button", name="Start", exact=True).click()
    other.get_by_role("button", name="Start", exact=True).click()
    for page, record, capacity in (
        (one, flown("medium", 51, "greedy"), 100),
        (other, flown("hard", 52, "optimal"), 160),
    ):
        results(page).get_by_role("button", name="Close").click()
        expect_frame(page, frames(server.url, record)[-1], capacity)


def test_a_page_that_goes_gives_its_sessions_back_without_a_complaint(tabs: Tabs) -> None:
    page = tabs.open("/?task=easy&seed=7")
    seed = page.get_by_role("spinbutton", name="Map")
    expect(seed).to_have_value("7")
    expect(page.locator("#step-counter")).to_contain_text("Step 0")
    page.evaluate("window.dispatchEvent(new PageTransitionEvent('pagehide', { persisted: false }))")
    # Answered after the sessions were given back, in order.
    page.get_by_role("button", name="New map").click()
    expect(seed).not_to_have_value("7")


def test_a_killed_server_comes_back_and_the_mission_goes_on_from_its_step(browser: Browser, tmp_path: Path) -> None:
    data, port = tmp_path / "data", reserved_port()
    flight = flown("hard", 7, "greedy")
    with serving(data, port=port) as server:
        tabs = Tabs(browser, server.url)
        tabs.expect("WebSocket connection to|ERR_CONNECTION_REFUSED")
        page = tabs.open("/?task=hard&seed=7&pilot=greedy")
        page.get_by_role("slider", name="Speed").fill("3")
        page.get_by_role("button", name="Start", exact=True).click()
        expect(page.locator("#step-counter")).to_have_text(re.compile("Step ([4-9]|1[0-9]) of 160"))
        server.kill()
        banner = page.get_by_role("alert").filter(has_text="The server is away")
        expect(banner).to_be_visible()
        expect(page.locator("#connection")).to_contain_text("away")
        flown_before = counter(page)
        assert 4 <= flown_before < len(flight.actions)
    with serving(data, port=port):
        expect(banner).to_be_hidden(timeout=20_000)
        expect(page.locator("#connection")).to_contain_text("Live")
        fastest(page)
        results(page)
        tabs.close()
    assert tabs.unexpected() == []
    with Store(data) as store:
        episodes = store.latest(10)
    assert [(episode.record.seed, episode.record.actions) for episode in episodes] == [(7, flight.actions)]


def test_a_token_is_asked_for_once(browser: Browser, tmp_path: Path) -> None:
    with serving(tmp_path / "data", TOKEN=TOKEN) as server:
        tabs = Tabs(browser, server.url)
        tabs.expect("401")
        page = tabs.open("/?task=easy&seed=7&pilot=greedy")
        dialog = page.get_by_role("dialog", name="This server asks for a token")
        dialog.get_by_label("Token").fill("wrong")
        dialog.get_by_role("button", name="Enter").click()
        expect(dialog).to_contain_text("The token was refused")
        dialog.get_by_label("Token").fill(TOKEN)
        dialog.get_by_role("button", name="Enter").click()
        expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
        fly(page)
        results(page)
        page.reload()
        expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
        expect(dialog).to_be_hidden()
        tabs.close()
        assert tabs.unexpected() == []
