"""What a visitor does to the page who means no good, or who does not know it: odd links, back and forth, lost sessions."""

import time
from collections.abc import Callable
from pathlib import Path
from urllib.request import Request, urlopen

import pytest
from playwright.sync_api import Browser, Page, WebSocket, expect

from drone_env.episodes.store import Store
from tests.api.serving import Server, serving
from tests.browser.flights import fill, flown
from tests.browser.stage import fastest, view
from tests.browser.tabs import NARROW, Tabs

GREEDY = "/?task=easy&seed=5&pilot=greedy"


@pytest.mark.parametrize("seed", ["-1", "9e99", "99999999999999999999999", "1.5"])
def test_a_link_to_no_map_says_above_the_maps_which_there_are(page: Page, seed: str) -> None:
    page.set_viewport_size(NARROW)
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
    page.goto("/health")
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


def sessions_of(tabs: Tabs, path: str) -> tuple[Page, list[str]]:
    """A page, and the sessions that it has been told of, which grow."""
    sessions: list[str] = []
    page = tabs.open(path, go=False)

    def hear(text: str | bytes) -> None:
        found = tabs_json(text)
        sessions.extend(one["mission"]["session"] for one in found.get("missions", []))

    def listen(socket: WebSocket) -> None:
        socket.on("framereceived", hear)

    page.on("websocket", listen)
    page.goto(path)
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    return page, sessions
