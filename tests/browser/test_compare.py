"""Compare: the leaderboard down to flights, two pilots by map, runs of models, trainings, and the newest flights."""

import re
import time
from pathlib import Path
from typing import Any

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Locator, Page, expect

from drone_env.results.store import Store
from tests.api.serving import Server
from tests.browser.conftest import MARKUP, SEEDS
from tests.browser.flights import fill, flown
from tests.browser.stage import fixed, percent, points, show, view
from tests.browser.tabs import NARROW, PATIENCE_MS, SMALL, Tabs
from tests.browser.test_everybody import findings

LISTED = 57
"""More than a page of flights."""


def compare(page: Page, task: str = "easy") -> None:
    """The view, with this task."""
    view(page, "Compare")
    page.get_by_role("combobox", name="Task").select_option(task)
    expect(page).to_have_url(re.compile(f"task={task}$"))


def get(server: Server, path: str, **query: Any) -> Any:
    return server.client.get(f"/{path}", params=query).raise_for_status().json()


def rows(page: Page, region: str) -> Locator:
    return page.get_by_role("region", name=region).locator("> table > tbody > tr")


def listed(page: Page) -> list[str]:
    """The flights that are listed, by id."""
    return page.locator("[data-episode]").evaluate_all("all => all.map(one => one.dataset.episode)")


def drawn(page: Page, chart: str) -> int:
    """How many pixels of a chart have the colour that values are drawn in."""
    return page.locator(f"[data-chart={chart}] canvas").evaluate(
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


def expect_drawn(page: Page, *charts: str) -> None:
    """Charts come to show values in the colour of the theme."""
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while min((found := {chart: drawn(page, chart) for chart in charts}).values()) <= 50:
        assert time.monotonic() < deadline, f"too few pixels of the accent's colour: {found}"


def test_the_leaderboard_opens_down_to_a_flight_and_the_address_says_what_is_open(page: Page, server: Server) -> None:
    compare(page)
    board = get(server, "leaderboard/easy")["rows"]
    lines = rows(page, "Leaderboard")
    expect(lines).to_have_count(len(board))
    for line, row in zip(lines.all(), board, strict=True):
        expect(line).to_contain_text(row["name"])
        expect(line).to_contain_text(points(row["score"]))
    greedy = next(row for row in board if row["agent"] == "greedy")
    line = lines.filter(has_text="Greedy")
    low, high = greedy["score_ci95"]
    expect(line).to_contain_text(f"{points(greedy['score'])} ± {points((high - low) / 2)}")
    expect(line).to_contain_text(percent(greedy["success_rate"]))
    # The whiskers stand where the interval ends.
    low, high = next(row for row in board if row["agent"] == "random")["score_ci95"]
    line = lines.filter(has_text="Random")
    bar, whiskers = line.locator(".bar").bounding_box(), line.locator(".bar b").bounding_box()
    assert bar is not None
    assert whiskers is not None
    assert abs((whiskers["x"] - bar["x"]) / bar["width"] - low) < 0.01
    assert abs(whiskers["width"] / bar["width"] - (high - low)) < 0.01
    page.get_by_role("button", name="Random", exact=True).click()
    expect(page).to_have_url(re.compile("task=easy&pilot=random$"))
    page.reload()
    expect(page.get_by_role("button", name="Random", exact=True)).to_have_attribute("aria-expanded", "true")
    maps = get(server, "leaderboard/easy/maps", agent="random")["maps"]
    worst = max(maps, key=lambda one: (one["optimum"] - one["score"], -one["seed"]))
    inner = rows(page, "Maps that Random flew")
    expect(inner).to_have_count(10)
    expect(inner.first.locator("td").first).to_have_text(str(worst["seed"]))
    page.get_by_role("button", name=f"All {len(maps)} maps").click()
    expect(inner).to_have_count(len(maps))
    page.get_by_role("button", name=f"Open the flight of Random over map {worst['seed']}", exact=True).click()
    expect(page).to_have_url(f"{server.url}/?episode={worst['id']}")
    page.go_back()
    expect(page.get_by_role("button", name="Random", exact=True)).to_have_attribute("aria-expanded", "true")
    # By keys: what had the focus keeps it.
    page.get_by_role("button", name="Random", exact=True).focus()
    page.keyboard.press("Enter")
    expect(inner).to_have_count(0)
    expect(page.get_by_role("button", name="Random", exact=True)).to_be_focused()


def test_two_pilots_are_paired_by_map(page: Page, server: Server) -> None:
    compare(page)
    page.get_by_role("checkbox", name=f"Compare {MARKUP}").check()
    page.get_by_role("checkbox", name="Compare Random").check()
    expect(page.get_by_text("They have flown no map in common yet.")).to_be_visible()
    # A third one: the first of the two goes.
    page.get_by_role("checkbox", name="Compare Greedy").check()
    expect(page.get_by_role("checkbox", name=f"Compare {MARKUP}")).not_to_be_checked()
    expect(page).to_have_url(re.compile("task=easy&pilots=random,greedy$"))
    expect(page.get_by_role("heading", name="Random against Greedy")).to_be_visible()
    pairing = get(server, "paired/easy", a="random", b="greedy")
    facts = page.locator("dl.paired")
    expect(facts).to_contain_text(fixed(pairing["difference"] * 100, 1))
    expect(facts).to_contain_text(" to ".join(fixed(bound * 100, 1) for bound in pairing["ci95"]))
    expect(facts.locator("dd")).to_contain_text(
        ["", *(str(pairing[name]) for name in ("maps", "wins", "ties", "losses"))]
    )
    first = max(pairing["pairs"], key=lambda pair: (abs(pair["difference"]), -pair["seed"]))
    expect(rows(page, "Random against Greedy").first.locator("td").first).to_have_text(str(first["seed"]))
    page.get_by_role("button", name=f"Fly both over map {first['seed']}", exact=True).click()
    expect(page).to_have_url(f"{server.url}/?task=easy&seed={first['seed']}&pilots=random,greedy")
    # Who is none of our pilots cannot fly again: their flights are opened.
    view(page, "Compare")
    page.get_by_role("combobox", name="Task").select_option("easy")
    page.get_by_role("checkbox", name="Compare scripted").check()
    page.get_by_role("checkbox", name="Compare Greedy").check()
    pair = get(server, "paired/easy", a="scripted", b="greedy")["pairs"][0]
    page.get_by_role("button", name=f"Open the flight of scripted over map {pair['seed']}", exact=True).click()
    expect(page).to_have_url(f"{server.url}/?episode={pair['a']['id']}")


def test_it_is_for_everybody(page: Page) -> None:
    show(page, "/?view=compare&task=easy&pilots=greedy,random")
    page.evaluate(Axe().axe_script)
    # One flight is enough: all are alike, and axe takes its time for each.
    page.get_by_role("combobox", name="Pilot").select_option(MARKUP)
    expect(page.locator("[data-episode]")).to_have_count(1)
    found: list[str] = []
    # The rest of the view is looked at with the other views.
    for pilots, region, part in (
        ("greedy,random", "Greedy against Random", ".compare-part:has(.paired)"),
        ("random", "Maps that Random flew", ".opened"),
    ):
        show(page, f"/?view=compare&task=easy&pilots={pilots}")
        expect(page.get_by_role("region", name=region)).to_be_visible()
        found += findings(page, part)
        page.set_viewport_size(NARROW)
        assert page.evaluate("document.documentElement.scrollWidth") == NARROW["width"]
        page.set_viewport_size(SMALL)
    assert found == []
    # What somebody elsewhere is called is text.
    assert page.locator("img[src=x]").count() == 0
    expect(rows(page, "Leaderboard").filter(has_text=MARKUP)).to_have_count(1)


def test_runs_of_models_and_agents_over_the_same_maps_stand_on_one_board(page: Page, server: Server) -> None:
    compare(page)
    (board,) = get(server, "leaderboard/easy/runs")["boards"]
    run, other = board["rows"]
    line = rows(page, "Runs over maps 14 to 15 (custom)")
    expect(line).to_have_count(2)
    for text in (run["agent"], run["prompt"], points(run["score"]), points(run["regret"]), f"{run['tokens']:,}"):
        expect(line.first).to_contain_text(text)
    for text in ("random", "flown", points(other["score"]), percent(other["success_rate"])):
        expect(line.last).to_contain_text(text)
    expect(line.last.locator("td").last).to_have_text("")
    page.get_by_text("Maps of random, flown").click()
    expect(rows(page, "Maps that random flew")).to_have_count(2)
    page.get_by_text("Maps of scripted, run").click()
    page.get_by_role("button", name="Open the flight of scripted over map 15").click()
    expect(page).to_have_url(f"{server.url}/?episode={run['maps'][1]['id']}")


def test_the_curve_of_a_training_grows_as_it_goes(page: Page, data: Path) -> None:
    compare(page)
    chart = page.locator("[data-chart=validation]")
    expect(chart).to_contain_text("50.0 at episode 3. The optimum of these maps: 95.0.")
    with (data / "train.log").open("a", encoding="utf-8") as file:
        file.write("episode=4 reward=5.0000 success=0.500 validation=0.6000 optimum=0.9500\n")
    expect(chart).to_contain_text("60.0 at episode 4.")
    expect_drawn(page, "validation", "reward")


def test_list_and_charts_show_the_same_flights(page: Page, server: Server) -> None:
    # Of a pilot that flies nowhere else: the store is that of all tests.
    new = fill(server.data, [flown("easy", seed, "random", label="listed") for seed in range(LISTED)])[::-1]
    compare(page)
    known = [one["id"] for one in get(server, "episodes", task="easy", limit=50)["episodes"]]
    page.get_by_role("combobox", name="Pilot").select_option("")
    flights = page.locator("[data-episode]")
    expect(flights).to_have_count(50)
    assert listed(page) == known
    # Of all pilots there is no mean.
    success = page.locator(".flight-charts [data-chart=success]")
    expect(success).to_be_hidden()
    page.get_by_role("combobox", name="Pilot").select_option("listed")
    expect(flights).to_have_count(50)
    assert listed(page) == new[:50]
    newest = get(server, "episodes", task="easy", agent="listed", limit=50)["episodes"]
    regret = sum(one["regret"] for one in newest) / 50
    expect(page.locator("[data-chart=lost]")).to_contain_text(f"{points(regret)} on average over 50 flights.")
    expect(page.locator(".flight-charts")).to_contain_text("of these 50 delivered everything.")
    page.get_by_role("button", name="Older").click()
    expect(flights).to_have_count(LISTED - 50)
    assert listed(page) == new[50:]
    expect(page.get_by_role("button", name="Older")).to_be_disabled()
    page.get_by_role("button", name="Newer").click()
    expect(flights).to_have_count(50)
    expect_drawn(page, "lost")
    page.get_by_role("button", name=re.compile("light colours")).click()
    expect_drawn(page, "lost")
    page.get_by_role("button", name=re.compile("dark colours")).click()
    with page.expect_download() as saved:
        page.get_by_role("button", name='Save the chart "Lost" as PNG').click()
    assert saved.value.suggested_filename == "lost.png"
    assert saved.value.path().read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    page.locator("[data-chart=lost] .u-over").click(position={"x": 60, "y": 60})
    expect(page).to_have_url(re.compile("episode="))
    assert page.url.rpartition("=")[2] in listed(page)


def test_a_flight_that_ends_elsewhere_appears_by_itself(page: Page, server: Server) -> None:
    compare(page, "hard")
    nobody = page.get_by_text("Nobody has flown this task yet")
    expect(nobody.or_(page.get_by_role("region", name="Leaderboard"))).to_be_visible()
    with Store(server.data) as store:
        new = [store.add_episode(flown("hard", SEEDS, "greedy", label="else, where")) for _ in range(2)]
    expect(page.locator(f"[data-episode='{new[1]}']")).to_be_visible()
    # The address keeps a name with a comma whole.
    page.get_by_role("button", name="else, where", exact=True).click()
    page.get_by_role("button", name="2 flights").click()
    expect(page.get_by_role("heading", name="Newest flights")).to_be_focused()
    expect(page.locator("[data-episode]")).to_have_count(2)
    assert listed(page) == new[::-1]
    page.get_by_role("button", name=f"All maps, not only map {SEEDS}").click()
    page.locator("[data-episode]").first.click()
    expect(page).to_have_url(f"{server.url}/?episode={new[1]}")


def test_a_task_that_is_none_is_told_and_another_can_be_chosen(page: Page, shared: Tabs) -> None:
    shared.expect("404")
    show(page, "/?view=compare&task=nowhere")
    problem = page.locator("#view-compare").get_by_role("alert")
    expect(problem).to_contain_text("nowhere")
    expect(problem).to_contain_text("easy, hard")
    page.get_by_role("combobox", name="Task").select_option("medium")
    expect(problem).to_be_hidden()
    expect(rows(page, "Leaderboard")).to_have_count(1)
