"""Compare: the leaderboard down to flights, two pilots by map, runs of models, trainings, and the newest flights."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from drone_env.flights.provenance import Provenance
from drone_env.flights.record import replay
from drone_env.flights.store import Store
from tests.api.serving import Server
from tests.browser.conftest import MARKUP, SEEDS
from tests.browser.flights import fill, flown, get
from tests.browser.shown import fixed, measured, points
from tests.browser.stage import press, show, view


def compare(page: Page, task: str = "easy") -> None:
    """Open the view with this task."""
    view(page, "Compare")
    page.get_by_role("combobox", name="Task").select_option(task)
    expect(page).to_have_url(re.compile(f"task={task}$"))


def board(page: Page) -> Locator:
    """The leaderboard of the flights on the server."""
    return page.get_by_role("region", name="Leaderboard")


def box(page: Page, name: str) -> Locator:
    """The box that compares a pilot of that leaderboard."""
    return page.get_by_role("checkbox", name=f"Compare {name}", exact=True)


def rows(page: Page, region: str) -> Locator:
    return page.get_by_role("region", name=region).locator("> table > tbody > tr")


def test_the_leaderboard_opens_down_to_a_flight_and_the_address_says_what_is_open(page: Page, server: Server) -> None:
    compare(page)
    flown_by = get(server, "leaderboard/easy")["rows"]
    lines = rows(page, "Leaderboard")
    expect(lines.filter(has_text="Random")).to_be_visible()
    # Tests before this one may have flown as several people.
    for more in page.get_by_role("button", name="More people: ").all():
        more.click()
    expect(lines).to_have_count(len(flown_by))
    chances = next(row for row in flown_by if row["agent"] == "random")
    low, high = chances["score_ci95"]
    line = lines.filter(has_text="Random")
    expect(line).to_contain_text(f"{points(chances['score'])} [{points(low)}, {points(high)}]")
    # The whiskers end where the interval ends.
    ends = measured(
        page,
        "#view-compare .bar b",
        """(([bar, ends]) => [(ends.left - bar.left) / bar.width, (ends.right - bar.left) / bar.width])(
            [one.parentNode, one].map(part => part.getBoundingClientRect()))""",
    )
    assert pytest.approx((low, high), abs=0.01) in map(tuple, ends)
    chance = board(page).get_by_role("button", name="Random", exact=True)
    chance.click()
    expect(page).to_have_url(re.compile("task=easy&pilot=random$"))
    page.reload()
    expect(chance).to_have_attribute("aria-expanded", "true")
    maps = get(server, "leaderboard/easy/maps", agent="random")["maps"]
    inner = rows(page, "Maps of Random")
    expect(inner).to_have_count(len(maps))
    first = max(maps, key=lambda one: (one["optimum"] - one["score"], -one["seed"]))
    expect(inner.first.locator("td").first).to_have_text(str(first["seed"]))
    page.get_by_role("link", name=f"Open the flight of Random over map {first['seed']}", exact=True).click()
    expect(page).to_have_url(f"{server.url}/?episode={first['id']}")
    page.go_back()
    expect(chance).to_have_attribute("aria-expanded", "true")
    # With the keyboard: the button keeps the focus.
    chance.press("Enter")
    expect(inner).to_have_count(0)
    expect(chance).to_be_focused()


def test_shipped_results_open_down_to_the_worst_map_of_a_network(page: Page, server: Server) -> None:
    compare(page, "skyline_medium")
    shipped = page.get_by_role("region", name="Runs over maps 6")
    shipped.get_by_role("button", name="Tournet", exact=True).click()
    run = get(server, "leaderboard/skyline_medium/runs")["boards"][-1]["rows"][0]["run"]
    maps = get(server, "leaderboard/skyline_medium/maps", agent="tournet", run=run)["maps"]
    losses = {one["seed"]: one["optimum"] - one["score"] for one in maps}
    # Each bar counts the maps that it selects.
    bars, inner = (
        page.get_by_role("group", name="Maps by points lost").get_by_role("button"),
        rows(page, "Maps of Tournet"),
    )
    expect(bars.first).to_have_text(re.compile(f"^{sum(loss <= 0.0005 for loss in losses.values())}"))
    bars.last.click()
    last = re.search(r"Lost ([0-9.]+) to ([0-9.]+): (\d+) map", bars.last.get_attribute("aria-label") or "")
    assert last
    worst = sorted((seed for seed in losses if 100 * losses[seed] > float(last[1])), key=lambda seed: -losses[seed])
    expect(inner).to_have_count(len(worst))
    assert len(worst) == int(last[3])
    bars.last.click()
    expect(inner).to_have_count(100)
    press(page, "Show all 1,000")
    expect(inner).to_have_count(1000)
    # A click on a column sorts, a second one turns the order.
    for column, name, value in ((2, "Score", "score"), (5, "Steps", "steps")):
        for order, least in (("descending", False), ("ascending", True)):
            press(page, name)
            expect(page.get_by_role("columnheader", name=name).last).to_have_attribute("aria-sort", order)
            found = (min if least else max)(one[value] for one in maps)
            shown = points(found) if value == "score" else str(int(found))
            expect(inner.first.locator("td").nth(column)).to_have_text(shown)
    press(page, "Lost")
    expect(inner.first.locator("td").first).to_have_text(str(worst[0]))
    inner.first.get_by_role("link").click()
    expect(page).to_have_url(re.compile(f"task=skyline_medium&seed={worst[0]}&pilot=tournet"))
    score = next(one["score"] for one in maps if one["seed"] == worst[0])
    expect(page.locator("#results-title")).to_be_visible()
    expect(page.locator("#view-fly")).to_contain_text(f"{points(score)} / ")
    # A link names pilots without a run.
    show(page, "/?view=compare&task=skyline_medium&pilots=tournet,optimal")
    expect(page.locator("dl.paired")).to_contain_text("Tournet scores higher")


def test_nothing_moves_while_it_loads(beside: Callable[..., Page]) -> None:
    page = beside()
    page.add_init_script(
        """window.shifts = 0;
        new PerformanceObserver(list => list.getEntries().forEach(one => (window.shifts += one.value)))
            .observe({type: "layout-shift", buffered: true});"""
    )
    page.goto("/?view=compare&task=easy")
    expect(page.locator("[data-chart=validation]")).to_be_visible()
    expect(page.locator("[data-episode]").first).to_be_visible()
    expect(board(page)).to_be_visible()
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert page.evaluate("window.shifts") <= 0.02


def test_commands_that_add_results_name_the_agents_that_fly_the_task(page: Page, server: Server) -> None:
    compare(page, "skyline_hard")
    runs = get(server, "leaderboard/skyline_hard/runs")["boards"][0]["rows"]
    agents = " ".join(run["agent"] for run in runs if run["shipped"])
    command = f"drone-env evaluate --task skyline_hard --agents {agents} --out data/evaluations/again"
    expect(page.locator("#view-compare .snippet code").first).to_have_text(command)


def test_a_link_to_pilots_that_have_not_flown_offers_to_fly_them(page: Page, server: Server) -> None:
    # No other test flies this task.
    fill(server.data, [flown("skyline_medium", 0, "greedy")])
    show(page, "/?view=compare&task=skyline_medium&pilots=optimal,carol")
    part = page.locator("#view-compare").get_by_role("status").filter(has_text="No flights of Skyline Medium by ")
    expect(part).to_have_text("No flights of Skyline Medium by carol yet. Fly now")
    expect(rows(page, "Leaderboard").first).to_contain_text("(few)")
    part.get_by_role("link").click()
    expect(page).to_have_url(re.compile(r"/\?task=skyline_medium&seed=[0-9]+&pilot=optimal$"))


def test_two_pilots_are_paired_by_map(page: Page, server: Server) -> None:
    compare(page)
    box(page, MARKUP).check()
    box(page, "Random").check()
    # A long name is broken into lines within its column.
    inside = "one.getBoundingClientRect().right <= one.closest('td').getBoundingClientRect().right"
    assert all(measured(page, "#view-compare td .named", inside))
    # The third pilot replaces the first, and a note names both.
    box(page, "Greedy").check()
    expect(box(page, MARKUP)).not_to_be_checked()
    expect(page.locator("#view-compare")).to_contain_text("Two pilots at most: Greedy takes the place of ")
    expect(page).to_have_url(re.compile("task=easy&pilots=random,greedy$"))
    pairing = get(server, "paired/easy", a="random", b="greedy")
    facts = page.locator("dl.paired")
    expect(facts).to_contain_text(" to ".join(fixed(bound * 100, 1) for bound in pairing["ci95"]))
    expect(facts.locator("dd").nth(2)).to_have_text(str(pairing["wins"]))
    first = max(pairing["pairs"], key=lambda pair: (abs(pair["difference"]), -pair["a"]["seed"]))["a"]
    expect(rows(page, "Random against Greedy").first.locator("td").first).to_have_text(str(first["seed"]))
    page.get_by_role("link", name=f"Fly both over map {first['seed']}", exact=True).click()
    expect(page).to_have_url(f"{server.url}/?task=easy&seed={first['seed']}&pilots=random,greedy")


def test_a_tick_moves_and_opens_nothing_and_a_name_ticks_nothing(page: Page, server: Server) -> None:
    fill(server.data, [flown("skyline_hard", 1, agent) for agent in ("greedy", "random", "optimal")])
    compare(page, "skyline_hard")
    boxes = board(page).get_by_role("checkbox")
    expect(boxes).to_have_count(3)
    address = page.url

    def places() -> list[float]:
        return measured(page, "#view-compare input[type=checkbox]", "one.getBoundingClientRect().top + scrollY")

    before, ticked = places(), page.get_by_role("checkbox", checked=True)
    boxes.nth(0).click()
    expect(ticked).to_have_count(1)
    assert (places(), page.url) == (before, address)
    boxes.nth(1).click()
    expect(page.locator("dl.paired")).to_be_visible()
    assert places() == before
    boxes.nth(1).click()
    expect(page).to_have_url(address)
    expect(ticked).to_have_count(1)
    expect(page.locator("dl.paired")).to_be_hidden()
    # Opening a row is another choice.
    board(page).get_by_role("button", name="Random").click()
    expect(rows(page, "Maps of Random")).to_have_count(1)
    expect(ticked).to_have_count(1)
    opened = places()
    boxes.nth(2).click()
    expect(page).to_have_url(re.compile("pilots="))
    assert places() == opened
    expect(board(page).get_by_role("button", expanded=True)).to_have_text("Random")


def test_many_people_leave_the_leaderboard_readable(page: Page, server: Server) -> None:
    flight = flown("city_small", 5, "greedy")
    people = [Provenance(pilot="human", person=f"Person-{number}") for number in range(30)]
    fill(server.data, [flight, *(flown("city_small", 5, "greedy", one) for one in people)])
    compare(page, "city_small")
    lines = rows(page, "Leaderboard")
    expect(lines).to_have_count(4)
    expect(lines.filter(has_text="Greedy")).to_have_count(1)
    # Ticked pilots stay listed, also from a link.
    show(page, "/?view=compare&task=city_small&pilots=greedy,human%20(Person-7)")
    expect(page.locator("dl.paired")).to_contain_text("Person-7 scores higher")
    expect(lines).to_have_count(5)
    # An untick, too, moves nothing.
    box(page, "Person-7").uncheck()
    expect(page.locator("dl.paired")).to_be_hidden()
    expect(lines).to_have_count(5)
    press(page, "More people: 26")
    expect(lines).to_have_count(31)
    expect(page.get_by_role("button", name="More people: 26")).to_have_attribute("aria-expanded", "true")
    # A person has one spelling, and one colour.
    newest = rows(page, "Flights, newest first").first
    expect(newest.locator("td").first).to_have_text("Person-29")
    colour = next(one["colour"] for one in get(server, "pilots")["pilots"] if one["id"] == "human")
    for line in (newest, lines.filter(has_text="Person-29")):
        expect(line.locator(".dot")).to_have_attribute("style", f"--colour: var(--pilot-{colour});")
    newest.get_by_role("link").click()
    expect(page.locator("#results-title")).to_have_text(re.compile("^Person-29: "))


def test_runs_of_models_and_trainings(page: Page, server: Server, data: Path) -> None:
    compare(page)
    chart = page.locator("[data-chart=validation]")
    expect(chart).to_contain_text("50.0 at episode 3. Optimum of these maps: 95.0.")
    with (data / "train.log").open("a", encoding="utf-8") as file:
        file.write("episode=4 reward=5.0000 success=0.500 validation=0.6000 optimum=0.9500\n")
    expect(chart).to_contain_text("60.0 at episode 4.")
    # The line runs from the least value at the first episode to the greatest at the last.
    expect(chart.locator("path")).to_have_attribute("d", re.compile(r"^M[0-9.]+ 100L100 0h0$"))
    run = get(server, "leaderboard/easy/runs")["boards"][0]["rows"][0]
    lines = rows(page, "Runs over maps 14 to 15 (custom)")
    expect(lines).to_have_count(2)
    # A pilot has the name and the colour that it has everywhere.
    expect(lines.last).to_contain_text("Random")
    colours = {one["id"]: one["colour"] for one in get(server, "pilots")["pilots"]}
    expect(lines.last.locator(".dot")).to_have_attribute("style", f"--colour: var(--pilot-{colours['random']});")
    for text in (run["agent"], run["prompt"], points(run["score"])):
        expect(lines.first).to_contain_text(text)
    press(page, "scripted by minimal-2")
    maps = get(server, "leaderboard/easy/maps", agent="scripted", run="run")["maps"]
    page.get_by_role("link", name="Open the flight of scripted over map 15", exact=True).click()
    expect(page).to_have_url(f"{server.url}/?episode={maps[1]['id']}")


def test_the_flights_of_one_pilot_are_listed_in_pages(page: Page, server: Server) -> None:
    # By a pilot that flies in no other test: the store is shared.
    new = fill(server.data, [flown("easy", seed, "random", label="listed") for seed in range(57)])[::-1]
    compare(page)
    flights = page.locator("[data-episode]")
    page.get_by_role("combobox", name="Pilot").select_option("listed")
    for button, listed in ((None, new[:50]), ("Older", new[50:]), ("Newer", new[:50])):
        if button:
            press(page, button)
        expect(flights.first).to_have_attribute("data-episode", listed[0])
        expect(flights).to_have_count(len(listed))
        assert measured(page, "[data-episode]", "one.dataset.episode") == listed


def test_a_flight_that_ends_elsewhere_appears_by_itself(page: Page, server: Server) -> None:
    compare(page, "hard")
    with Store(server.data) as store:
        episode = replay(flown("hard", SEEDS, "greedy"))
        new = [store.add_episode(episode, "else, where") for _ in range(2)]
    expect(page.locator(f"[data-episode='{new[1]}']")).to_be_visible()
    # The address keeps a name with a comma whole.
    press(page, "else, where")
    expect(page).to_have_url(re.compile(r"pilot=else%2C%20where$"))
    expect(rows(page, "Maps of else, where")).to_have_count(1)
