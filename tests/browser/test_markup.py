"""Whatever has HTML in it is shown as text."""

import json
import re
from collections.abc import Callable
from urllib.parse import quote

import pytest
from playwright.sync_api import Page, Route, WebSocketRoute, expect

from tests.browser.conftest import MARKUP
from tests.browser.stage import press, show, standings, view


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
    expect_only_text(hostile)
    show(hostile, f"/?task={quote(MARKUP)}&seed=7")
    expect(hostile.locator(".problems")).to_contain_text(MARKUP)
    view(hostile, "API")
    expect(hostile.get_by_role("log", name="Training")).to_contain_text(MARKUP)
    expect_only_text(hostile)
