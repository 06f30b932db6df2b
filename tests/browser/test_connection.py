"""Two tabs at once, pages that go, sessions that are ended, a server that wants a token, is killed and comes back."""

import json
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, WebSocketRoute, expect

from drone_env.results.store import Store
from drone_env.server.incoming import TRY_LATER
from drone_env.server.live.socket import TOO_MANY_PAGES
from tests.api.serving import Server, serving
from tests.browser.flights import flown, frames
from tests.browser.stage import FASTEST, at_speed, counter, ended, expect_frame, fly, opened, show, view
from tests.browser.tabs import PATIENCE_MS, Tabs
from tests.tools import reserved_port

TOKEN = "let-me-in"
Beside = Callable[[str], Page]


def test_two_tabs_fly_two_flights_at_once(page: Page, beside: Beside, server: Server) -> None:
    show(page, "/?task=medium&seed=51&pilot=greedy")
    other = beside("/?task=easy&seed=52&pilot=optimal")
    for one, steps in ((page, 100), (other, 60)):
        expect(one.locator("#step-counter")).to_have_text(f"Step 0 of {steps}")
        at_speed(one, FASTEST)
    for one in (page, other):
        one.get_by_role("button", name="Start", exact=True).click()
    for one, record, capacity in (
        (page, flown("medium", 51, "greedy"), 100),
        (other, flown("easy", 52, "optimal"), 60),
    ):
        ended(one)
        expect_frame(one, frames(server, record)[-1], capacity)


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
    return server.client.get("/state", headers={"X-Session-Id": session}).status_code == 200


def until(page: Page, holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while not holds():
        assert time.monotonic() < deadline
        # Not `sleep`: what a page hears is told here while Playwright is at work alone.
        page.wait_for_timeout(50)


def test_sessions_end_with_their_page_and_one_that_is_ended_elsewhere_begins_anew(
    page: Page, told: tuple[Page, list[str]], server: Server
) -> None:
    tab, sessions = told
    where, step = tab.locator("#step-counter"), tab.get_by_role("button", name="Step", exact=True)

    def end_by(went: int, now: int) -> None:
        until(page, lambda: len(sessions) == now)
        until(page, lambda: not any(is_open(server, session) for session in sessions[:went]))
        assert all(is_open(server, session) for session in sessions[went:])

    tab.goto("/?task=hard&seed=5&pilots=greedy,random,random,random")
    expect(where).to_have_text("Step 0 of 160")
    fly(tab)
    expect(where).not_to_have_text("Step 0 of 160")
    tab.reload()
    end_by(4, 8)
    show(tab, "/?task=hard&seed=5&pilot=greedy")
    end_by(8, 9)
    server.client.delete("/session", headers={"X-Session-Id": sessions[8]}).raise_for_status()
    expect(where).to_have_text("Step 0 of 160")
    step.click()
    expect(tab.locator("#toasts")).to_contain_text("it starts again")
    end_by(9, 10)
    step.click()
    expect(where).to_contain_text("Step 1 of 160")
    expect(tab.get_by_role("spinbutton", name="Map")).to_have_value("5")
    # A page that may come back keeps its own.
    tab.evaluate("window.dispatchEvent(new PageTransitionEvent('pagehide', { persisted: true }))")
    step.click()
    expect(where).to_contain_text("Step 2 of 160")
    tab.evaluate("window.dispatchEvent(new PageTransitionEvent('pagehide', { persisted: false }))")
    end_by(10, 10)
    tab.get_by_role("button", name="New map").click()
    expect(where).to_have_text("Step 0 of 160")
    end_by(10, 11)
    tab.close()
    until(page, lambda: not is_open(server, sessions[10]))


def test_a_server_that_wants_a_token_is_killed_and_comes_back_and_the_flight_goes_on(
    beside: Beside, shared: Tabs, tmp_path: Path
) -> None:
    """The token is asked for until it is right, and once a tab: a page that connects anew has it still."""
    data, port = tmp_path / "data", reserved_port()
    flight = flown("hard", 7, "greedy")
    shared.expect("401|WebSocket connection to|ERR_CONNECTION_REFUSED")
    with serving(data, port=port, TOKEN=TOKEN) as server:
        page = beside(f"{server.url}/?task=hard&seed=7&pilot=greedy")
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
        where, dot = page.locator("#step-counter"), page.locator("#connection")
        expect(dot).to_contain_text("Live")
        expect(where).to_have_text("Step 0 of 160")
        at_speed(page, "2")
        page.get_by_role("button", name="Start", exact=True).click()
        expect(where).to_contain_text(re.compile("Step ([2-9]|[1-9][0-9]) of 160"))
        server.kill()
        banner = page.get_by_role("alert").filter(has_text="The server is away. Your flight is kept.")
        expect(banner).to_be_visible()
        expect(dot).to_contain_text("away")
        seen = counter(page)
        assert 2 <= seen < len(flight.actions)
        # What has been flown can be looked at; another flight would not be kept, and so does not begin.
        page.get_by_role("button", name="Step back").click()
        expect(where).to_contain_text(f"Step {seen - 1} of 160")
        page.get_by_role("button", name="New map").click()
        expect(page.locator("#toasts")).to_contain_text("your flight is kept")
        page.get_by_role("button", name="Random", exact=True).click()
        expect(page.get_by_role("button", name="Greedy", exact=True)).to_have_attribute("aria-pressed", "true")
        expect(page.get_by_role("button", name="Random", exact=True)).to_have_attribute("aria-pressed", "false")
        at_speed(page, FASTEST)
        with serving(data, port=port, TOKEN=TOKEN):
            expect(banner).to_be_hidden()
            expect(dot).to_contain_text("Live")
            expect(ended(page)).to_contain_text("Greedy")
            expect(page.get_by_role("spinbutton", name="Map")).to_have_value("7")
            expect(page).to_have_url(re.compile(f"step={len(flight.actions)}$"))
            page.reload()
            expect(where).to_contain_text(f"Step {len(flight.actions)} of")
            expect(dialog).to_be_hidden()
    with Store(data) as store:
        episodes = store.latest(10)
    kept = {(episode.record.seed, *episode.record.actions) for episode in episodes}
    assert kept == {(7, *flight.actions)}


def test_a_server_that_ends_each_connection_is_asked_five_times_and_then_when_the_visitor_says(
    browser: Browser, server: Server
) -> None:
    """As where what the page asks for is what the server dies of: the flight it goes on with, for one."""
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
        # A view that could not be loaded meanwhile is loaded then.
        page.route("**/compare.js", lambda route: route.abort())
        view(page, "Compare")
        missing = page.get_by_role("alert").filter(has_text="This view could not be loaded.")
        expect(missing).to_be_visible()
        expect(page.locator("#toasts .toast")).to_have_count(0)
        page.unroute("**/compare.js")
        page.route("**/learn.css", lambda route: route.abort())
        view(page, "Learn")
        expect(missing).to_be_visible()
        page.unroute("**/learn.css")
        missing.get_by_role("button", name="Try again").click()
        expect(page.get_by_role("heading", name="Learn", exact=True, level=2)).to_be_visible()
        expect(missing).to_be_hidden()
        view(page, "Compare")
        connections[-1].close(code=1011)
        expect(dot).to_contain_text("away")
        page.clock.run_for(8000)
        expect(page.get_by_role("heading", name="Who flies best")).to_be_visible()


def test_a_full_server_is_called_full_and_never_live_before(beside: Beside, shared: Tabs) -> None:
    """It is not away, and what it has no room for is not kept. Such a server says so once it has let the page in.

    A file that is opened meanwhile is what stands there once it has room.
    """
    page = beside("")
    starts: list[dict[str, Any]] = []
    room = False
    page.add_init_script(
        """addEventListener("DOMContentLoaded", () => {
            const said = window.said = [], dot = document.getElementById("connection");
            const observed = { childList: true, characterData: true, subtree: true };
            new MutationObserver(() => said.push(dot.textContent)).observe(dot, observed);
        })"""
    )

    def connect(socket: WebSocketRoute) -> None:
        if not room:
            socket.on_message(lambda _: socket.close(code=TRY_LATER, reason=TOO_MANY_PAGES))
            return
        beyond = socket.connect_to_server()

        def pass_on(text: str | bytes) -> None:
            message = json.loads(text)
            if message["type"] == "start":
                starts.append(message)
            beyond.send(text)

        socket.on_message(pass_on)

    page.route_web_socket("**/live", connect)
    page.goto("/?task=hard&seed=7&pilot=greedy")
    banner = page.get_by_role("alert").filter(has_text="The server is full (too many pages are open).")
    expect(banner).to_contain_text("Trying again")
    expect(page.locator("#banner-text")).not_to_contain_text("kept")
    expect(page.locator("#connection")).to_have_text("Server full")
    assert set(page.evaluate("said")) == {"Server full"}
    opened(page, flown("easy", 21, "greedy", label="me"))
    button = banner.get_by_role("button", name="Try now").element_handle()
    room = True
    # At once: the page tries by itself before long, and then there is nothing left to click at.
    button.evaluate("button => button.click()")
    expect(page.locator("#connection")).to_have_text("Live")
    page.go_back()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    assert [message["seed"] for message in starts] == [7]
