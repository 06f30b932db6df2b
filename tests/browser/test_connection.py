"""Pages that close, sessions that end elsewhere, a server that wants a token, is killed, comes back, or is full."""

import json
import re
from collections.abc import Callable
from pathlib import Path

from playwright.sync_api import Page, WebSocketRoute, expect

from drone_env.flights.store import Store
from drone_env.server.json_routes import TRY_LATER
from drone_env.server.live.socket import TOO_MANY_PAGES
from tests.api.serving import Server, serving
from tests.browser.flights import flown
from tests.browser.shown import counter, expect_step
from tests.browser.stage import FASTEST, at_speed, ended, enter, press, show, until, view
from tests.browser.tabs import Tabs
from tests.tools import reserved_port

Beside = Callable[..., Page]


def test_sessions_end_with_their_page(beside: Beside, server: Server) -> None:
    tab, sessions = beside(), list[str]()

    def read(text: str | bytes) -> None:
        sessions.extend(shown["opening"]["session"] for shown in json.loads(text).get("flights", []))

    def expect_sessions(over: int, now: int) -> None:
        """The server has named `now` sessions: the first `over` of them have ended, the others are open."""

        def state() -> list[bool]:
            answers = (server.client.get("/state", headers={"X-Session-Id": session}) for session in sessions)
            return [answer.status_code == 200 for answer in answers]

        until(tab, lambda: state() == [False] * over + [True] * (now - over))

    tab.on("websocket", lambda socket: socket.on("framereceived", read))
    tab.goto("/?task=hard&seed=5&pilots=greedy,random")
    expect_step(tab, 0, 160)
    show(tab, "/?task=hard&seed=5&pilot=greedy")
    expect_sessions(2, 3)
    server.client.delete("/session", headers={"X-Session-Id": sessions[2]}).raise_for_status()
    expect_step(tab, 0, 160)
    press(tab, "Step")
    expect(tab.locator("#toasts")).to_contain_text("It starts again")
    expect_sessions(3, 4)
    tab.evaluate("window.dispatchEvent(new PageTransitionEvent('pagehide', { persisted: false }))")
    expect_sessions(4, 4)


def test_a_flight_goes_on_when_a_killed_server_comes_back(beside: Beside, shared: Tabs, tmp_path: Path) -> None:
    """The page asks for the token until it is right, and once a tab: a page that reconnects still has it."""
    data, port = tmp_path / "data", reserved_port()
    flight = flown("hard", 7, "greedy")
    shared.expect("401|WebSocket connection to|ERR_CONNECTION_REFUSED")
    with serving(data, port=port, TOKEN="let-me-in") as server:
        page = beside(f"{server.url}/?task=hard&seed=7&pilot=greedy&step=1")
        dialog = page.get_by_role("dialog", name="This server requires a token")
        expect(dialog).to_be_visible()
        page.keyboard.press("Escape")
        field = dialog.get_by_label("Token")
        enter(field, "wrong")
        expect(dialog).to_contain_text("The server rejected this token")
        expect(field).to_be_empty()
        enter(field, "let-me-in")
        where, dot = page.locator("#step-counter"), page.locator("#connection")
        expect(dot).to_contain_text("Live")
        expect_step(page, 1, 160)
        at_speed(page, "2")
        press(page, "Resume")
        expect(where).to_contain_text(re.compile("Step ([2-9]|[1-9][0-9]) of 160"))
        server.kill()
        banner = page.get_by_role("alert").filter(has_text="The server is away. Your flight is kept.")
        expect(banner).to_be_visible()
        expect(dot).to_contain_text("away")
        seen = counter(page)
        assert 2 <= seen < len(flight.actions)
        # The visitor can look back; another flight does not start, because this one would be lost.
        press(page, "Step back")
        expect_step(page, seen - 1, 160)
        expect(page).to_have_url(re.compile(f"step={seen - 1}$"))
        press(page, "New map")
        expect(page.locator("#toasts")).to_contain_text("Your flight is kept")
        at_speed(page, FASTEST)
        with serving(data, port=port, TOKEN="let-me-in"):
            expect(banner).to_be_hidden()
            expect(dot).to_contain_text("Live")
            ended(page)
            # The visitor still looks back, and a link to this moment says that the flight has ended.
            expect(page).to_have_url(re.compile(f"step={seen - 1}&ended={len(flight.actions)}$"))
            press(page, "Last step")
            expect(page).to_have_url(re.compile(f"seed=7&.*step={len(flight.actions)}$"))
            page.reload()
            expect(where).to_contain_text(f"Step {len(flight.actions)} of")
            expect(dialog).to_be_hidden()
    with Store(data) as store:
        assert {tuple(episode.record.actions) for episode in store.episodes()} == {tuple(flight.actions)}


def test_a_full_server_is_called_full_and_never_live_before(beside: Beside, shared: Tabs) -> None:
    """Such a server accepts the connection, then closes it. A view that failed to load is loaded once there is room."""
    page = beside()
    room = False
    page.add_init_script(
        """addEventListener("DOMContentLoaded", () => {
            const said = window.said = [], dot = document.getElementById("connection");
            new MutationObserver(() => said.push(dot.textContent)).observe(dot, { childList: true, subtree: true });
        })"""
    )

    def connect(socket: WebSocketRoute) -> None:
        if room:
            socket.connect_to_server()
        else:
            socket.on_message(lambda _: socket.close(code=TRY_LATER, reason=TOO_MANY_PAGES))

    page.route_web_socket("**/live", connect)
    page.goto("/?task=hard&seed=7&pilot=greedy")
    banner = page.get_by_role("alert").filter(has_text="The server is full (too many pages are open).")
    expect(banner).to_contain_text("Next try")
    expect(page.locator("#banner-text")).not_to_contain_text("kept")
    expect(page.locator("#connection")).to_have_text("Server full")
    assert set(page.evaluate("said")) == {"Server full"}
    shared.expect("compare.js|Failed to fetch")
    page.route("**/compare.js", lambda route: route.abort())
    view(page, "Compare")
    expect(page.get_by_role("alert").filter(has_text="This view could not be loaded.")).to_be_visible()
    page.unroute("**/compare.js")
    room = True
    # By script: the page tries by itself before long, and then the button is gone. One of the two tries is given up.
    shared.expect("WebSocket is closed before the connection is established")
    page.evaluate("document.getElementById('banner-retry').click()")
    expect(page.locator("#connection")).to_have_text("Live")
    expect(page.get_by_role("heading", name="Leaderboard")).to_be_visible()
    view(page, "Fly")
    expect_step(page, 0, 160)
