"""What a visitor does who means no good, or does not know the page: odd links, back and forth, lost sessions."""

import json
import time
from collections.abc import Callable, Generator
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Browser, Page, expect

from tests.api.serving import Server, serving
from tests.browser.flights import fill, flown
from tests.browser.stage import fly, view
from tests.browser.tabs import NARROW, WIDE, Tabs
from tests.browser.test_history import drawn
from tests.tools import reserved_port

GREEDY = "/?task=easy&seed=5&pilot=greedy"


@pytest.fixture
def phone(page: Page) -> Generator[Page, None, None]:
    page.set_viewport_size({"width": NARROW["width"], "height": NARROW["height"]})
    yield page
    page.set_viewport_size({"width": WIDE["width"], "height": WIDE["height"]})


@pytest.mark.parametrize("seed", ["-1", "99999999999999999999999"])
def test_a_link_to_no_map_says_above_the_maps_which_there_are(phone: Page, seed: str) -> None:
    page = phone
    page.goto(f"/?seed={seed}")
    problem = page.locator("#deck").get_by_role("alert")
    expect(problem).to_contain_text("a whole number from 0 to 9007199254740991")
    expect(problem).to_be_in_viewport()
    assert f"seed={seed}" in page.url
    page.get_by_role("button", name="New map").click()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    expect(problem).to_be_hidden()


@pytest.mark.parametrize("link", ["/#constructor", "/#toString", "/?episode=", "/?pilots=", "/?pilots=,,#nothing"])
def test_a_link_to_nothing_opens_watch(page: Page, link: str) -> None:
    page.goto("about:blank")
    page.goto(link)
    expect(page).to_have_title("Watch a mission · Drone Delivery")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")


def test_back_goes_back_though_the_link_has_changed(page: Page) -> None:
    page.goto(GREEDY)
    expect(page.locator(".card")).to_have_count(1)
    view(page, "Race")
    expect(page.locator(".card")).to_have_count(4)
    page.go_back()
    expect(page).to_have_title("Watch a mission · Drone Delivery")
    expect(page.locator(".card")).to_have_count(1)
    page.go_forward()
    expect(page.locator(".card")).to_have_count(4)


@pytest.fixture
def told(tabs: Tabs) -> tuple[Page, list[str]]:
    """A page on which nothing is open, and the sessions of which the server will tell it."""
    page, sessions = tabs.open(go=False), list[str]()

    def hear(text: str | bytes) -> None:
        for shown in json.loads(text).get("missions", []):
            sessions.append(shown["mission"]["session"])

    page.on("websocket", lambda socket: socket.on("framereceived", hear))
    return page, sessions


def is_open(server: Server, session: str) -> bool:
    return httpx.get(f"{server.url}/state", headers={"X-Session-Id": session}).status_code == 200


def test_a_page_that_is_reloaded_or_closed_gives_its_sessions_back(
    told: tuple[Page, list[str]], server: Server
) -> None:
    page, sessions = told
    page.goto("/?task=hard&seed=5&pilots=greedy,random,random,random")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    fly(page)
    expect(page.locator("#step-counter")).not_to_have_text("Step 0 of 160")
    page.reload()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    assert len(sessions) == 8
    assert all(is_open(server, session) for session in sessions[4:])
    page.close()
    until(lambda: not any(is_open(server, session) for session in sessions))


def test_a_mission_that_somebody_has_ended_starts_anew(told: tuple[Page, list[str]], server: Server) -> None:
    page, sessions = told
    page.goto("/?task=hard&seed=5&pilot=greedy")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    httpx.delete(f"{server.url}/session", headers={"X-Session-Id": sessions[0]}).raise_for_status()
    page.get_by_role("button", name="Step", exact=True).click()
    expect(page.locator("#toasts")).to_contain_text("it starts anew")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    page.get_by_role("button", name="Step", exact=True).click()
    expect(page.locator("#step-counter")).to_have_text("Step 1 of 160")
    assert len(sessions) == 2


def test_the_history_of_all_tasks_charts_what_was_flown(browser: Browser, tmp_path: Path) -> None:
    fill(tmp_path / "data", [flown("medium", 3, "optimal")])
    with serving(tmp_path / "data") as server:
        tabs = Tabs(browser, server.url)
        page = tabs.open("/#history")
        expect(page.get_by_role("heading", name="Medium: 1 episode")).to_be_visible()
        for chart in ("Success, last 20 episodes", "Regret"):
            expect(page.get_by_role("figure").filter(has_text=chart).locator("canvas")).to_be_visible()
            assert drawn(page, chart) > 0
        tabs.close()
        assert tabs.unexpected() == []


def test_a_token_cannot_be_escaped_from_and_the_history_comes_when_the_server_does(
    browser: Browser, tmp_path: Path
) -> None:
    data, port = tmp_path / "data", reserved_port()
    with serving(data, port=port, TOKEN="let-me-in") as server:
        tabs = Tabs(browser, server.url)
        tabs.expect("401|WebSocket connection to|ERR_CONNECTION_REFUSED")
        page = tabs.open("/#specs")
        dialog = page.get_by_role("dialog", name="This server asks for a token")
        expect(dialog).to_be_visible()
        for _ in range(3):
            page.keyboard.press("Escape")
        dialog.get_by_label("Token").fill("\u2603")
        page.keyboard.press("Enter")
        expect(dialog).to_contain_text("The token was refused")
        dialog.get_by_label("Token").fill("let-me-in")
        page.keyboard.press("Enter")
        expect(page.locator("#connection")).to_contain_text("Live")
        server.kill()
        expect(page.locator("#connection")).to_contain_text("away")
        view(page, "History")
        note = page.locator("#history").get_by_role("status")
        expect(note).to_contain_text("could not be loaded")
    with serving(data, port=port, TOKEN="let-me-in"):
        expect(note).to_have_text("No episode yet. Fly one, and it stands here.", timeout=20_000)
        tabs.close()
    assert tabs.unexpected() == []


def test_the_specifications_fit_a_phone(phone: Page) -> None:
    phone.goto("/#specs")
    table = phone.locator(".specs-table")
    expect(table).to_be_visible()
    assert table.evaluate("table => table.scrollWidth <= table.parentElement.clientWidth")
    cells = table.locator("td").evaluate_all("all => all.every(cell => cell.scrollWidth <= cell.clientWidth)")
    assert cells, "a value runs into its neighbour"


def until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.05)
