"""Two tabs at once, pages that go, sessions that are ended, a server that wants a token, is killed and comes back."""

import json
import re
import time
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, Page, WebSocketRoute, expect

from drone_env.episodes.store import Store
from drone_env.server.incoming import TRY_LATER
from drone_env.server.live.socket import TOO_MANY_PAGES
from tests.api.serving import Server, serving
from tests.browser.flights import flown, frames
from tests.browser.stage import counter, expect_frame, fastest, fly, results, slow, view
from tests.browser.tabs import PATIENCE_MS, Tabs
from tests.tools import reserved_port

TOKEN = "let-me-in"
Beside = Callable[[str], Page]


def test_two_tabs_fly_two_missions_at_once(page: Page, beside: Beside, server: Server) -> None:
    page.goto("/?task=medium&seed=51&pilot=greedy")
    other = beside("/?task=easy&seed=52&pilot=optimal")
    for one in (page, other):
        expect(one.locator("#step-counter")).to_contain_text("Step 0 of")
        fastest(one)
    page.get_by_role("button", name="Start", exact=True).click()
    other.get_by_role("button", name="Start", exact=True).click()
    for one, record, capacity in (
        (page, flown("medium", 51, "greedy"), 100),
        (other, flown("easy", 52, "optimal"), 60),
    ):
        results(one).get_by_role("button", name="Close").click()
        expect_frame(one, frames(server.url, record)[-1], capacity)


@pytest.fixture
def told(beside: Beside) -> tuple[Page, list[str]]:
    """A page on which nothing is open, and the sessions of which the server will tell it."""
    page, sessions = beside(""), list[str]()

    def hear(text: str | bytes) -> None:
        for shown in json.loads(text).get("flights", []):
            sessions.append(shown["opening"]["session"])

    page.on("websocket", lambda socket: socket.on("framereceived", hear))
    return page, sessions


def is_open(server: Server, session: str) -> bool:
    return httpx.get(f"{server.url}/state", headers={"X-Session-Id": session}).status_code == 200


def until(page: Page, holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while not holds():
        assert time.monotonic() < deadline
        # Not `sleep`: what a page hears is told here while Playwright is at work alone.
        page.wait_for_timeout(50)


def test_a_page_that_is_reloaded_or_closed_gives_its_sessions_back(
    page: Page, told: tuple[Page, list[str]], server: Server
) -> None:
    tab, sessions = told
    tab.goto("/?task=hard&seed=5&pilots=greedy,random,random,random")
    expect(tab.locator("#step-counter")).to_have_text("Step 0 of 160")
    fly(tab)
    expect(tab.locator("#step-counter")).not_to_have_text("Step 0 of 160")
    tab.reload()
    expect(tab.locator("#step-counter")).to_have_text("Step 0 of 160")
    until(page, lambda: len(sessions) == 8)
    assert all(is_open(server, session) for session in sessions[4:])
    until(page, lambda: not any(is_open(server, session) for session in sessions[:4]))
    tab.close()
    until(page, lambda: not any(is_open(server, session) for session in sessions))


def test_a_mission_that_is_ended_elsewhere_starts_anew_and_a_page_that_goes_ends_its_own(
    told: tuple[Page, list[str]], server: Server
) -> None:
    page, sessions = told
    page.goto("/?task=hard&seed=5&pilot=greedy")
    until(page, lambda: len(sessions) == 1)
    where, step = page.locator("#step-counter"), page.get_by_role("button", name="Step", exact=True)
    expect(where).to_have_text("Step 0 of 160")
    httpx.delete(f"{server.url}/session", headers={"X-Session-Id": sessions[0]}).raise_for_status()
    step.click()
    expect(page.locator("#toasts")).to_contain_text("it starts again")
    until(page, lambda: len(sessions) == 2)
    step.click()
    expect(where).to_have_text("Step 1 of 160")
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value("5")
    # A page that may come back keeps its own.
    page.evaluate("window.dispatchEvent(new PageTransitionEvent('pagehide', { persisted: true }))")
    step.click()
    expect(where).to_have_text("Step 2 of 160")
    page.evaluate("window.dispatchEvent(new PageTransitionEvent('pagehide', { persisted: false }))")
    until(page, lambda: not is_open(server, sessions[1]))
    page.get_by_role("button", name="New map").click()
    expect(where).to_have_text("Step 0 of 160")
    until(page, lambda: len(sessions) == 3)


def test_a_server_that_wants_a_token_is_killed_and_comes_back_and_the_mission_goes_on(
    browser: Browser, tmp_path: Path
) -> None:
    """The token is asked for until it is right, and once a tab: a page that connects anew has it still."""
    data, port = tmp_path / "data", reserved_port()
    flight = flown("hard", 7, "greedy")
    with serving(data, port=port, TOKEN=TOKEN) as server, Tabs(browser, server.url) as tabs:
        tabs.expect("401|WebSocket connection to|ERR_CONNECTION_REFUSED")
        page = tabs.open("/?task=hard&seed=7&pilot=greedy", reduced_motion="reduce")
        dialog = page.get_by_role("dialog", name="This server asks for a token")
        expect(dialog).to_be_visible()
        for _ in range(3):
            page.keyboard.press("Escape")
        for wrong in ("\u2603", "wrong"):
            dialog.get_by_label("Token").fill(wrong)
            page.keyboard.press("Enter")
            expect(dialog).to_contain_text("The token was refused")
            expect(dialog.get_by_label("Token")).to_be_empty()
        dialog.get_by_label("Token").fill(TOKEN)
        dialog.get_by_role("button", name="Enter").click()
        expect(page.locator("#connection")).to_contain_text("Live")
        expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
        slow(page)
        page.get_by_role("button", name="Start", exact=True).click()
        expect(page.locator("#step-counter")).to_have_text(re.compile("Step ([2-9]|[1-9][0-9]) of 160"))
        server.kill()
        banner = page.get_by_role("alert").filter(has_text="The server is away. Your flight is kept.")
        expect(banner).to_be_visible()
        expect(page.locator("#connection")).to_contain_text("away")
        assert 2 <= counter(page) < len(flight.actions)
        view(page, "History")
        note = page.locator("#view-history").get_by_role("status")
        expect(note).to_contain_text("could not be loaded")
        with serving(data, port=port, TOKEN=TOKEN):
            expect(note).to_have_text(re.compile("No episode yet|Page 1"))
            expect(banner).to_be_hidden()
            expect(page.locator("#connection")).to_contain_text("Live")
            view(page, "Watch")
            fastest(page)
            expect(page.locator("#start")).to_have_text("Fly again")
            page.reload()
            expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
            expect(dialog).to_be_hidden()
    assert tabs.unexpected() == []
    with Store(data) as store:
        episodes = store.latest(10)
    assert [(episode.record.seed, episode.record.actions) for episode in episodes] == [(7, flight.actions)]


def test_a_server_that_ends_each_connection_is_asked_five_times_and_then_when_the_visitor_says(
    browser: Browser, server: Server
) -> None:
    """As where what the page asks for is what the server dies of: the mission it goes on with, for one."""
    connections: list[WebSocketRoute] = []

    def connect(socket: WebSocketRoute) -> None:
        connections.append(socket)
        beyond = socket.connect_to_server()

        def pass_on(text: str | bytes) -> None:
            socket.send(text)
            if json.loads(text)["type"] == "flights" and len(connections) != 7:
                socket.close(code=1011)

        beyond.on_message(pass_on)

    with Tabs(browser, server.url) as tabs:
        page = tabs.open(go=False, reduced_motion="reduce")
        page.route_web_socket("**/live", connect)
        # Time passes while the page waits to connect anew, and not while it is connected, however slow the machine.
        page.clock.install(time=0)
        page.clock.pause_at(1000)
        page.goto("/?task=hard&seed=7&pilot=greedy")
        dot = page.locator("#connection")
        banner = page.get_by_role("alert").filter(has_text="The server refused the connection (it has ended ")
        again = banner.get_by_role("button", name="Try now")

        def given_up() -> bool:
            if dot.get_attribute("data-state") == "away":
                page.clock.run_for(500)
            return again.is_visible()

        until(page, given_up)
        page.clock.run_for(600_000)
        assert len(connections) == 5
        expect(banner).to_contain_text("it has ended 5 in a row")
        again.click()
        until(page, lambda: len(connections) == 6)
        expect(banner).to_contain_text("it has ended 6 in a row")
        again.click()
        expect(dot).to_contain_text("Live")
        expect(banner).to_be_hidden()
        # One that lasts is a good one, and what was before it is forgotten.
        page.clock.run_for(10_000)
        connections[-1].close(code=1011)
        expect(page.get_by_role("alert").filter(has_text="The server is away. Your flight is kept.")).to_be_visible()
        page.clock.run_for(1000)
        until(page, lambda: len(connections) == 8)


def test_a_full_server_is_called_full(browser: Browser, server: Server) -> None:
    """It is not away, and what it has no room for is not kept."""
    with Tabs(browser, server.url) as tabs:
        page = tabs.open(go=False, reduced_motion="reduce")
        page.route_web_socket("**/live", lambda socket: socket.close(code=TRY_LATER, reason=TOO_MANY_PAGES))
        page.goto("/?task=hard&seed=7&pilot=greedy")
        banner = page.get_by_role("alert").filter(has_text="The server is full (too many pages are open).")
        expect(banner).to_contain_text("Trying again")
        expect(page.locator("#banner-text")).not_to_contain_text("kept")
        expect(page.locator("#connection")).to_have_text("Server full")
