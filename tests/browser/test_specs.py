"""The technical specifications: what the page shows is what `/tasks` and `/kinds` say."""

import re
from collections.abc import Callable

import httpx
import pytest
from playwright.sync_api import Page, Route, expect

from tests.api.serving import Server
from tests.browser.stage import view
from tests.browser.tabs import Tabs


def table(page: Page, name: str) -> dict[str, list[str]]:
    """The cells of each row, by the row's heading."""
    rows = page.get_by_role("table", name=name).evaluate(
        "table => [...table.rows].map(row => [...row.cells].map(cell => cell.textContent))"
    )
    found: dict[str, list[str]] = {}
    profile = ""
    for name, *cells in rows:
        if not cells:
            paid = re.match(r"Rewards per step \((\w+)\)", name)
            profile = f", {paid[1]}" if paid else ""
        found[name + profile] = cells
    return found


@pytest.mark.feature("D4")
def test_the_levels_stand_side_by_side_as_the_server_tells_them(page: Page, server: Server) -> None:
    tasks = httpx.get(f"{server.url}/tasks").json()["tasks"]
    view(page, "Specifications")
    for family in ("City", "Skyline"):
        page.get_by_role("radio", name=family).check()
        shown = table(page, f"Technical specifications of the {family} levels")
        levels = [task for task in tasks if task["family"] == family.lower()]
        assert len(levels) == 3
        assert shown["Id"] == [task["id"] for task in levels]
        assert shown["Grid"] == [f"{task['width']} × {task['height']}" for task in levels]
        numbers = {
            "Parcels": "deliveries",
            "Buildings": "buildings",
            "Obstacles": "obstacles",
            "Steps at most": "max_steps",
        }
        for row, name in numbers.items():
            assert shown[row] == [str(task[name]) for task in levels]
        for row, event in (("Delivery", "delivery"), ("Above a tree", "tree"), ("Wait", "wait")):
            for profile in ("tiered", "composite"):
                pays = [" / ".join(f"{pay:.2f}" for pay in task["rewards"][profile][event]) for task in levels]
                assert shown[f"{row}, {profile}"] == pays
        assert shown["Battery"] == [f"{task['battery_capacity']} units" for task in levels]
        if family == "City":
            assert shown["Grid"] == ["10 × 10", "14 × 14", "18 × 18"]
            assert shown["Parcels"] == ["1", "3", "5"]
    assert "Charging pads" in shown


def test_a_task_of_a_plugin_stands_under_its_own_family(beside: Callable[[str], Page]) -> None:
    def tasks(route: Route) -> None:
        answer = route.fetch()
        known = answer.json()
        known["tasks"].append(known["tasks"][0] | {"id": "hop", "short_name": "parcel_hop", "family": "parcel"})
        route.fulfill(response=answer, json=known)

    page = beside("")
    page.route("**/tasks", tasks)
    page.goto("/")
    for family, levels in (("City", 3), ("Skyline", 3), ("Parcel", 1)):
        row = page.get_by_role("group", name=family, exact=True)
        expect(row.get_by_role("radio")).to_have_count(levels)
    expect(page.get_by_role("radio", name="Parcel Hop")).to_be_attached()
    view(page, "Specifications")
    page.get_by_role("radio", name="Parcel", exact=True).check()
    assert table(page, "Technical specifications of the Parcel levels")["Id"] == ["hop"]


def test_all_calls_stand_at_docs_and_can_be_tried_without_the_internet(shared: Tabs, server: Server) -> None:
    shared.forget()
    docs = shared.open(go=False)
    asked: list[str] = []
    docs.on("request", lambda request: asked.append(request.url))
    docs.goto("/docs")
    call = docs.locator("#operations-catalogue-health")
    call.click()
    call.get_by_role("button", name="Try it out").click()
    call.get_by_role("button", name="Execute").click()
    expect(call.get_by_text('"status": "healthy"').first).to_be_visible()
    assert [url for url in asked if not url.startswith((server.url, "data:", "blob:"))] == []
    assert shared.unexpected() == []
    docs.close()


def test_the_legend_tells_what_each_kind_of_cell_does(page: Page, server: Server) -> None:
    kinds = httpx.get(f"{server.url}/kinds").json()["kinds"]
    view(page, "Specifications")
    legend = page.get_by_role("region", name="Legend")
    expect(legend.locator("dt")).to_have_text([f"{kind['emoji']}{kind['name']}" for kind in kinds])
    expect(legend.locator("dd")).to_have_text([kind["effect"] for kind in kinds])


def test_help_says_of_buildings_and_rewards_what_the_server_does(page: Page, server: Server) -> None:
    told = httpx.get(f"{server.url}/tasks").json()
    page.get_by_role("button", name="Keys and help").click()
    dialog = page.get_by_role("dialog", name="Mission control")
    facts = dict(zip(*(dialog.locator(f".costs {part}").all_inner_texts() for part in ("dt", "dd")), strict=True))
    for profile in told["reward_profiles"]:
        assert facts.pop(f"Rewards {profile['id']}") == profile["summary"]
    drains = "a step above a building drains 3 units of battery; a step above a tree drains 2 units of battery"
    assert facts == {"Skyline": f"{drains}; cannot be entered: obstacle"}
    expect(dialog).not_to_contain_text("cost reward")
    page.keyboard.press("Escape")
