"""Whatever has HTML in it is shown as text."""

import json
import re
from collections.abc import Callable
from urllib.parse import quote

import pytest
from playwright.sync_api import Page, Route, WebSocketRoute, expect

from tests.api.serving import Server
from tests.browser.conftest import MARKUP, SEEDS
from tests.browser.flights import flown, get
from tests.browser.stage import opened, press, show, standings, view


@pytest.fixture
def hostile(beside: Callable[..., Page]) -> Page:
    """A page before a server that puts HTML into all its words."""

    def spoiled(text: str, *fields: str) -> str:
        for field in fields:
            text = text.replace(f'"{field}":"', f'"{field}":{json.dumps(MARKUP)[:-1]}')
        return text

    def words(route: Route) -> None:
        answer = route.fetch()
        fields = ("grader", "summary") if route.request.url.endswith("tasks") else ("name", "summary")
        route.fulfill(response=answer, body=spoiled(answer.text(), *fields))

    def socket(route: WebSocketRoute) -> None:
        route.connect_to_server().on_message(lambda message: route.send(spoiled(str(message), "message")))

    page = beside()
    page.route(re.compile("/(tasks|pilots|kinds)$"), words)
    page.route_web_socket("**/live", socket)
    page.goto("/?task=easy&seed=7&pilots=greedy,random")
    return page


def expect_only_text(page: Page) -> None:
    """The markup is on the page, and nothing has come of it."""
    expect(page.get_by_text(MARKUP).first).to_be_attached()
    assert page.locator("img[src=x]").count() == 0
    assert page.locator("main b").filter(has_text="bold").count() == 0
    assert page.title() != "1"


def test_in_tasks_pilots_and_messages(hostile: Page) -> None:
    expect(standings(hostile)).to_contain_text([MARKUP, MARKUP])
    press(hostile, "Step")
    expect(hostile.locator("#move-detail")).to_contain_text(MARKUP)
    expect(hostile.get_by_role("group", name="Pilots")).to_contain_text(MARKUP)
    hostile.get_by_role("checkbox", name="A board each").check()
    expect(hostile.locator(".card-name").first).to_contain_text(MARKUP)
    expect_only_text(hostile)
    view(hostile, "Learn")
    expect(hostile.get_by_role("region", name="Reward profiles")).to_contain_text(MARKUP)
    expect_only_text(hostile)


def test_in_links_and_what_is_wrong_with_them(page: Page) -> None:
    for name in ("task", "pilot", "profile"):
        show(page, f"/?{name}={quote(MARKUP)}&seed=7")
        expect(page.locator(".problems")).to_contain_text(MARKUP)
        expect_only_text(page)


def test_in_agents_calls_logs_and_files(page: Page, server: Server) -> None:
    listed = get(server, "episodes", agent=MARKUP)["episodes"]
    call = {"step": 1, "messages": [{"role": MARKUP, "content": MARKUP}], "answer": MARKUP, "outcome": MARKUP}
    page.route("**/calls", lambda route: route.fulfill(json={"model": MARKUP, "calls": [call]}))
    show(page, f"/?episode={listed[0]['id']}")
    expect(page.locator(".strip")).to_contain_text(MARKUP)
    page.keyboard.press("Home")
    for said in ("#llm-answer", "#llm-prompt", ".calls h2"):
        expect(page.locator(said)).to_contain_text(MARKUP)
    expect_only_text(page)
    page.unroute("**/calls")
    show(page, "/?view=compare&task=easy")
    press(page, MARKUP)
    expect(page.get_by_role("region", name=f"Maps that {MARKUP} flew")).to_be_visible()
    page.get_by_role("combobox", name="Pilot").select_option(MARKUP)
    expect(page.locator("[data-episode]")).to_have_count(1)
    page.get_by_role("checkbox", name="Compare Random").check()
    expect(page.get_by_role("heading", name=f"{MARKUP} against Random")).to_be_visible()
    expect_only_text(page)
    view(page, "API")
    expect(page.get_by_role("log", name="Training")).to_contain_text(MARKUP)
    expect_only_text(page)
    view(page, "Fly")
    opened(page, flown("easy", SEEDS + 1, "greedy", label=f"{MARKUP} again"))
    expect_only_text(page)
