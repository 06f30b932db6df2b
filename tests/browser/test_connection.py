"""Pages that close or are idle, sessions that end elsewhere, a server that wants a token, is killed and comes back."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, Response, expect

from drone_env.flights.store import Store
from tests.api.serving import Server, serving
from tests.browser.flights import flown
from tests.browser.shown import expect_step
from tests.browser.stage import enter, fly, keys, press, show, standings, until
from tests.browser.tabs import Tabs
from tests.tools import reserved_port

Beside = Callable[..., Page]


def test_sessions_end_with_their_page(beside: Beside, shared: Tabs, server: Server) -> None:
    tab, sessions = beside(), list[str]()
    shared.expect("410")

    def read(response: Response) -> None:
        if response.url.endswith("/flights"):
            flights = response.json()["flights"]
            sessions.extend(flight["opening"]["session"] for flight in flights if flight["version"])

    def expect_open(*expected: bool) -> None:
        """The open sessions among those that the server has named."""

        def state() -> list[bool]:
            answers = (server.client.get("/state", headers={"X-Session-Id": session}) for session in sessions)
            return [answer.status_code == 200 for answer in answers]

        until(tab, lambda: state() == [*expected])

    tab.on("response", read)
    tab.goto("/?task=hard&seed=5&pilots=human,random")
    expect_step(tab, 0, 160)
    show(tab, "/?task=hard&seed=5&pilot=human")
    expect_open(False, True)
    keys(tab, " ", " ")
    expect_step(tab, 2, 160)
    server.client.delete("/session", headers={"X-Session-Id": sessions[1]}).raise_for_status()
    # No key is lost, however fast they come.
    keys(tab, *[" "] * 5, "u", "u")
    expect(tab.locator("#toasts")).to_contain_text("It starts again")
    expect_step(tab, 5, 160)
    expect(tab.get_by_role("button", name="Undo", exact=True)).to_be_enabled()
    expect(tab).to_have_url(re.compile("of=human~~u&actions=WWWWW"))
    expect_open(False, False, True)
    tab.evaluate("window.dispatchEvent(new PageTransitionEvent('pagehide', { persisted: false }))")
    expect_open(False, False, False)


@pytest.mark.long
def test_a_visitor_flies_on_when_a_killed_server_comes_back_and_pilots_do_not_wait(
    beside: Beside, shared: Tabs, tmp_path: Path
) -> None:
    """The page asks for the token until it is right, and once a tab."""
    data, port = tmp_path / "data", reserved_port()
    flight = flown("hard", 7, "greedy")
    shared.expect("401|ERR_CONNECTION_REFUSED|ERR_EMPTY_RESPONSE|ERR_CONNECTION_RESET")
    with serving(data, port=port, TOKEN="let-me-in") as server:
        page = beside(f"{server.url}/?task=hard&seed=7&pilots=human,greedy")
        dialog = page.get_by_role("dialog", name="This server requires a token")
        expect(dialog).to_be_visible()
        page.keyboard.press("Escape")
        field = dialog.get_by_label("Token")
        enter(field, "wrong")
        expect(dialog).to_contain_text("The server rejected this token")
        expect(field).to_be_empty()
        enter(field, "let-me-in")
        dot = page.locator("#connection")
        expect(dot).to_contain_text("Live")
        expect_step(page, 0, 160)
        page.locator("#step-counter").click()
        keys(page, " ")
        expect_step(page, 1, 160)
        other = standings(page).filter(has_text="Greedy").get_by_role("cell").first
        expect(other).to_have_text("1")
        server.kill()
        keys(page, *[" "] * 3)
        banner = page.get_by_role("alert").filter(has_text="The server is away. Your flight is kept.")
        expect(banner).to_be_visible()
        expect(dot).to_contain_text("away")
        # The others fly on without the server. Another flight does not start, because this one would be lost.
        fly(page, "Resume")
        expect(other).to_have_text(str(len(flight.actions)))
        press(page, "New map")
        press(page, "Give up")
        expect(page.locator("#toasts")).to_contain_text("Your flight is kept")
        with serving(data, port=port, TOKEN="let-me-in"):
            expect(banner).to_be_hidden()
            expect(dot).to_contain_text("Live")
            expect_step(page, 4, 160)
            expect(page).to_have_url(re.compile(f"actions=WWWW&ended={len(flight.actions)}$"))
            page.reload()
            expect_step(page, 4, 160)
            expect(dialog).to_be_hidden()
    with Store(data) as store:
        assert [tuple(episode.record.actions) for episode in store.episodes()] == [tuple(flight.actions)]


def test_an_idle_page_draws_and_asks_nothing(shared: Tabs) -> None:
    page, asked = shared.open(reduced_motion="no-preference"), list[str]()
    page.on("request", lambda request: asked.append(request.url))
    for path in ("/", "/?task=city&seed=7&pilots=greedy,tournet&step=20"):
        page.goto(path)
        expect_step(page, *((20, 640) if "city" in path else (0, 100)))
        page.evaluate("""() => {
            const draw = requestAnimationFrame;
            window.requestAnimationFrame = (drawn) => ((window.drawn += 1), draw(drawn));
        }""")

        def idles() -> bool:
            asked.clear()
            page.evaluate("window.drawn = 0")
            page.wait_for_timeout(1000)
            return page.evaluate("window.drawn") == 0 and asked == []

        until(page, idles)  # what the page loads has arrived
    page.context.close()
