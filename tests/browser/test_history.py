"""The history of episodes: table, filters, pages, charts."""

import re
import time
from typing import Any

import httpx
from playwright.sync_api import Page, expect

from drone_env.episodes.store import Store
from tests.api.serving import Server
from tests.browser.conftest import SEEDS
from tests.browser.flights import flown
from tests.browser.stage import fixed, percent, points, view
from tests.browser.tabs import PATIENCE_MS

CHARTS = ("Reward", "Success, last 20 episodes", "Actions", "Regret")


def shown_ids(page: Page) -> list[str]:
    return page.locator("tr[data-episode]").evaluate_all("rows => rows.map(row => row.dataset.episode)")


def listed(server: Server, **query: Any) -> list[dict[str, Any]]:
    return httpx.get(f"{server.url}/episodes", params=query).json()["episodes"]


def drawn(page: Page, chart: str) -> int:
    """How many pixels of a chart have the colour that values are drawn in."""
    figure = page.get_by_role("figure").filter(has=page.get_by_role("heading", name=chart, exact=True))
    return figure.locator("canvas").evaluate(
        """canvas => {
            const probe = document.createElement("canvas").getContext("2d");
            probe.fillStyle = getComputedStyle(document.documentElement).getPropertyValue("--accent");
            probe.fillRect(0, 0, 1, 1);
            const [r, g, b] = probe.getImageData(0, 0, 1, 1).data;
            const copy = document.createElement("canvas");
            [copy.width, copy.height] = [canvas.width, canvas.height];
            const ctx = copy.getContext("2d", { willReadFrequently: true });
            ctx.drawImage(canvas, 0, 0);
            const { data } = ctx.getImageData(0, 0, copy.width, copy.height);
            let found = 0;
            for (let i = 0; i < data.length; i += 4) found += data[i] === r && data[i + 1] === g && data[i + 2] === b;
            return found;
        }"""
    )


def expect_drawn(page: Page, least: int = 50) -> None:
    """Every chart comes to show values in the colour of the theme."""
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while min((found := {chart: drawn(page, chart) for chart in CHARTS}).values()) <= least:
        assert time.monotonic() < deadline, f"too few pixels of the accent's colour: {found}"


def test_it_lists_filters_and_pages_what_the_store_has(page: Page, server: Server) -> None:
    view(page, "History")
    page.get_by_role("combobox", name="Task").select_option("easy")
    page.get_by_role("combobox", name="Agent").select_option("greedy")
    rows = page.locator("tr[data-episode]")
    known = listed(server, task="easy", agent="greedy", limit=200)
    expect(rows.first).to_have_attribute("data-episode", known[0]["id"])
    expect(rows.nth(24)).to_have_attribute("data-episode", known[24]["id"])
    assert shown_ids(page) == [episode["id"] for episode in known[:25]]
    first = known[0]
    expect(rows.first).to_contain_text(f"{first['deliveries']} / {first['deliveries_total']}")
    expect(rows.first).to_contain_text(fixed(first["reward_total"]))
    expect(rows.first).to_contain_text(points(first["score"]))
    page.get_by_role("button", name="Older").click()
    expect(rows).to_have_count(len(known) - 25)
    assert shown_ids(page) == [episode["id"] for episode in known[25:]]
    expect(page.get_by_role("button", name="Older")).to_be_disabled()
    page.get_by_role("button", name="Newer").click()
    expect(rows).to_have_count(25)
    expect(page.get_by_role("button", name="Newer")).to_be_disabled()


def test_the_charts_draw_and_say_what_the_server_counts_in_both_themes(page: Page, server: Server) -> None:
    view(page, "History")
    page.get_by_role("combobox", name="Task").select_option("easy")
    analysis = httpx.get(f"{server.url}/analyse/easy").json()
    charts = page.get_by_role("region", name="Charts")
    expect(charts).to_contain_text(f"{fixed(analysis['average_reward'])} on average over")
    expect(charts).to_contain_text(f"{percent(analysis['success_rate'])} delivered everything")
    for action, share in analysis["action_distribution"].items():
        expect(charts).to_contain_text(f"{action} {percent(share)}")
    expect_drawn(page)
    page.get_by_role("button", name=re.compile("light colours")).click()
    expect_drawn(page)
    page.get_by_role("button", name=re.compile("dark colours")).click()


def test_a_chart_can_be_saved_and_a_click_in_it_replays(page: Page) -> None:
    view(page, "History")
    page.get_by_role("combobox", name="Task").select_option("easy")
    with page.expect_download() as saved:
        page.get_by_role("button", name='Save the chart "Reward" as PNG').click()
    assert saved.value.suggested_filename == "reward.png"
    assert saved.value.path().read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    page.locator(".u-over").first.click(position={"x": 60, "y": 60})
    expect(page.get_by_role("slider", name="Step of the flight")).to_be_visible()
    expect(page.get_by_role("heading", name=re.compile(r"Easy Delivery, map \d+, flown by"))).to_be_visible()


def test_a_click_on_an_episode_replays_it(page: Page, server: Server) -> None:
    view(page, "History")
    page.get_by_role("combobox", name="Task").select_option("medium")
    page.get_by_role("combobox", name="Agent").select_option("greedy")
    episode = listed(server, task="medium", agent="greedy")[0]
    page.locator(f"tr[data-episode='{episode['id']}']").get_by_role("button", name="Replay").click()
    heading = f"Medium Delivery, map {episode['seed']}, flown by {episode['agent']}"
    expect(page.get_by_role("heading", name=heading)).to_be_visible()
    assert f"episode={episode['id']}" in page.url
    expect(page.get_by_role("slider", name="Step of the flight")).to_have_attribute("max", str(episode["steps"]))


def test_an_episode_that_ends_elsewhere_appears_by_itself(page: Page, server: Server) -> None:
    view(page, "History")
    page.get_by_role("combobox", name="Task").select_option("hard")
    page.get_by_role("combobox", name="Agent").select_option("")
    expect(page.get_by_text("No episode yet").or_(page.locator("tr[data-episode]").first)).to_be_visible()
    with Store(server.data) as store:
        new = store.add_episode(flown("hard", SEEDS, "greedy", label="elsewhere"))
    row = page.locator(f"tr[data-episode='{new}']")
    expect(row).to_be_visible()
    expect(row).to_contain_text("elsewhere")


def test_the_history_of_all_tasks_charts_the_task_of_the_newest_flight(page: Page, server: Server) -> None:
    with Store(server.data) as store:
        store.add_episode(flown("skyline_easy", 14, "greedy"))
    view(page, "History")
    page.get_by_role("combobox", name="Agent").select_option("")
    page.get_by_role("combobox", name="Task").select_option("")
    expect(page.get_by_role("heading", name="Skyline Easy: 1 episode")).to_be_visible()
    # The only one, and it has given nothing away.
    expect_drawn(page, least=0)
