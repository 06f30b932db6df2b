"""Whatever has HTML in it is shown as text."""

import json
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote

import pytest
from playwright.sync_api import Page, Route, WebSocketRoute, expect

from tests.api.serving import Server
from tests.browser.conftest import MARKUP, SEEDS
from tests.browser.flights import flown
from tests.browser.stage import show, view


@pytest.fixture
def hostile(beside: Callable[[str], Page]) -> Page:
    """A page before a server that puts HTML into whatever it says in words."""

    def tasks(route: Route) -> None:
        answer = route.fetch()
        known = answer.json()
        for task in known["tasks"]:
            task["grader"] = MARKUP
        known["tasks"][2]["short_name"] = MARKUP
        for profile in known["reward_profiles"]:
            profile["summary"] = profile["id"] = MARKUP
        route.fulfill(response=answer, json=known)

    def words(route: Route) -> None:
        answer = route.fetch()
        text = answer.text().replace('"name":"', f'"name":{json.dumps(MARKUP)[:-1]}')
        route.fulfill(response=answer, body=text.replace('"summary":"', f'"summary":{json.dumps(MARKUP)[:-1]}'))

    def socket(route: WebSocketRoute) -> None:
        upstream = route.connect_to_server()

        def rewritten(message: str | bytes) -> None:
            route.send(str(message).replace('"message":"', f'"message":{json.dumps(MARKUP)[:-1]}'))

        upstream.on_message(rewritten)

    page = beside("")
    page.route("**/tasks", tasks)
    page.route("**/pilots", words)
    page.route("**/kinds", words)
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
    expect(hostile.locator("#standings tbody tr")).to_have_count(2)
    expect(hostile.locator("#standings")).to_contain_text(MARKUP)
    hostile.get_by_role("button", name="Step", exact=True).click()
    expect(hostile.locator("#move-detail")).to_contain_text(MARKUP)
    expect(hostile.get_by_role("group", name="Pilots")).to_contain_text(MARKUP)
    hostile.get_by_role("checkbox", name="A board each").check()
    expect(hostile.locator(".card-name").first).to_contain_text(MARKUP)
    expect_only_text(hostile)
    hostile.get_by_role("button", name="Keys and help").click()
    expect_only_text(hostile)
    hostile.keyboard.press("Escape")
    view(hostile, "Learn")
    expect(hostile.get_by_role("table").first).to_contain_text(MARKUP)
    expect_only_text(hostile)


def test_in_links_and_what_is_wrong_with_them(page: Page) -> None:
    for name in ("task", "pilot", "profile"):
        show(page, f"/?{name}={quote(MARKUP)}&seed=7")
        expect(page.locator(".problems")).to_contain_text(MARKUP)
        expect_only_text(page)


def test_in_agents_calls_logs_and_files(page: Page, server: Server, tmp_path: Path) -> None:
    listed = server.client.get("/episodes", params={"agent": MARKUP}).json()["episodes"]
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
    page.get_by_role("button", name=MARKUP, exact=True).click()
    expect(page.get_by_role("region", name=f"Maps that {MARKUP} flew")).to_be_visible()
    page.get_by_role("combobox", name="Pilot").select_option(MARKUP)
    expect(page.locator("[data-episode]")).to_have_count(1)
    page.get_by_role("checkbox", name="Compare Random").check()
    expect(page.get_by_role("heading", name=f"{MARKUP} against Random")).to_be_visible()
    expect_only_text(page)
    view(page, "API")
    expect(page.get_by_role("log", name="Training")).to_contain_text(MARKUP)
    expect_only_text(page)
    file = tmp_path / "flight.json"
    file.write_text(flown("easy", SEEDS + 1, "greedy", label=f"{MARKUP} again").to_json(), encoding="utf-8")
    view(page, "Fly")
    page.get_by_label("Open a file…").set_input_files(file)
    expect(page.locator(".strip")).to_contain_text(f"{MARKUP} again")
    expect_only_text(page)
