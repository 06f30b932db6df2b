"""The page shows HTML in names and messages as text."""

import json
import re
from collections.abc import Callable
from urllib.parse import quote

from playwright.sync_api import Page, Route, expect

from tests.browser.conftest import MARKUP
from tests.browser.stage import choices, press, show, standings, view
from tests.browser.tabs import Tabs


def spoiled(text: str, *fields: str) -> str:
    """The text of a server that puts HTML into these words."""
    for field in fields:
        text = text.replace(f'"{field}":"', f'"{field}":{json.dumps(MARKUP)[:-1]}')
    return text


def words(route: Route) -> None:
    answer = route.fetch()
    fields = ("grader", "summary") if route.request.url.endswith("tasks") else ("name", "summary")
    route.fulfill(response=answer, body=spoiled(answer.text(), *fields))


def messages(route: Route) -> None:
    answer = route.fetch()
    route.fulfill(response=answer, body=spoiled(answer.text(), "message"))


def test_in_tasks_pilots_and_messages(beside: Callable[..., Page], shared: Tabs) -> None:
    page = beside()
    shared.expect("422")
    page.route(re.compile("/(tasks|pilots|kinds)$"), words)
    page.route("**/flights/agent", messages)
    page.goto("/?task=easy&seed=7&pilots=greedy,random")
    expect(standings(page)).to_contain_text([MARKUP, MARKUP])
    press(page, "Step")
    expect(page.locator("#move-detail")).to_contain_text(MARKUP)
    expect(choices(page)).to_contain_text(MARKUP)
    show(page, f"/?task={quote(MARKUP)}&seed=7")
    expect(page.locator(".problems")).to_contain_text(MARKUP)
    view(page, "API")
    expect(page.get_by_role("log", name="Training")).to_contain_text(MARKUP)
    # Nothing has come of it. The views that are hidden keep their elements.
    expect(page.locator("img[src=x]")).to_have_count(0)
    expect(page.locator("main b").filter(has_text="bold")).to_have_count(0)
    assert page.title() != "1"
