"""Compare: the leaderboard down to flights, two pilots by map, runs of models, and the newest flights."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, Route, expect

from drone_env.flights.provenance import Provenance
from drone_env.flights.record import replay
from drone_env.flights.store import Store
from tests.api.serving import Server
from tests.browser.conftest import MARKUP, SEEDS
from tests.browser.flights import fill, flown, get
from tests.browser.shown import fixed, measured, points
from tests.browser.stage import press, show, until, view


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


def test_the_leaderboard_leads_to_a_flight_and_the_address_names_its_pilot(page: Page, server: Server) -> None:
    compare(page)
    flown_by = get(server, "leaderboard/easy")["rows"]
    lines = rows(page, "Leaderboard")
    expect(lines.filter(has_text="Random")).to_be_visible()
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
    board(page).get_by_role("link", name="Random", exact=True).click()
    expect(page).to_have_url(re.compile("task=easy&pilot=random$"))
    # The maps may be below the window.
    expect(page.get_by_role("heading", name="Maps of Random")).to_be_in_viewport()
    page.reload()
    expect(box(page, "Random")).to_be_checked()
    maps = get(server, "leaderboard/easy/maps", agent="random")["maps"]
    inner = rows(page, "Maps of Random")
    expect(inner).to_have_count(len(maps))
    first = max(maps, key=lambda one: (one["optimum"] - one["score"], -one["seed"]))
    expect(inner.first.locator("td").first).to_have_text(str(first["seed"]))
    page.get_by_role("link", name=f"Open the flight of Random over map {first['seed']}", exact=True).click()
    expect(page).to_have_url(f"{server.url}/?episode={first['id']}")
    page.go_back()
    expect(box(page, "Random")).to_be_checked()
    # With the keyboard: the box keeps the focus.
    box(page, "Random").press("Space")
    expect(inner).to_have_count(0)
    expect(box(page, "Random")).to_be_focused()


@pytest.mark.long
def test_shipped_results_lead_to_the_worst_map_of_a_network(page: Page, server: Server) -> None:
    compare(page, "skyline_medium")
    page.get_by_role("region", name="Runs over maps 6").get_by_role("link", name="Tournet", exact=True).click()
    run = get(server, "leaderboard/skyline_medium/runs")["boards"][-1]["rows"][0]["run"]
    maps = get(server, "leaderboard/skyline_medium/maps", agent="tournet", run=run)["maps"]
    losses = {one["seed"]: one["optimum"] - one["score"] for one in maps}
    bars = page.get_by_role("group", name="Maps by points lost").get_by_role("button")
    inner = rows(page, "Maps of Tournet")
    # Each bar counts the maps that it selects.
    expect(bars.first).to_have_text(re.compile(f"^{sum(loss <= 0.0005 for loss in losses.values())}"))
    bars.last.click()
    last = re.search(r"Lost ([0-9.]+) to ([0-9.]+): (\d+) map", bars.last.get_attribute("aria-label") or "")
    assert last
    worst = sorted((seed for seed in losses if 100 * losses[seed] > float(last[1])), key=lambda seed: -losses[seed])
    expect(inner).to_have_count(len(worst))
    assert len(worst) == int(last[3])
    bars.last.click()
    expect(inner).to_have_count(200)
    # A click on a column sorts, a second one turns the order.
    table = page.get_by_role("region", name="Maps of Tournet")
    for order, least in (("descending", False), ("ascending", True)):
        table.get_by_role("button", name="Steps").click()
        expect(table.get_by_role("columnheader", name="Steps")).to_have_attribute("aria-sort", order)
        found = (min if least else max)(one["steps"] for one in maps)
        expect(inner.first.locator("td").nth(5)).to_have_text(str(int(found)))
    table.get_by_role("button", name="Lost").click()
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
    expect(rows(page, "Flights, newest first").first).to_be_visible()
    expect(board(page)).to_be_visible()
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    assert page.evaluate("window.shifts") <= 0.02


def test_commands_that_add_results_name_the_agents_that_fly_the_task(page: Page, server: Server) -> None:
    compare(page, "skyline_hard")
    runs = get(server, "leaderboard/skyline_hard/runs")["boards"][0]["rows"]
    agents = " ".join(run["agent"] for run in runs if run["shipped"])
    command = f"drone-env evaluate --task skyline_hard --agents {agents} --out data/evaluations/again"
    expect(page.locator("#view-compare .snippet code").first).to_have_text(command)


def test_a_link_to_pilots_that_have_not_flown_names_them(page: Page) -> None:
    show(page, "/?view=compare&task=skyline_medium&pilots=optimal,carol")
    expect(page.locator("#view-compare").get_by_role("status")).to_have_text(
        "No flights of Skyline Medium by carol yet."
    )
    press(page, "Show all 1,000")
    expect(rows(page, "Maps of Optimal")).to_have_count(1000)


def test_two_pilots_are_paired_by_map(page: Page, server: Server) -> None:
    compare(page)
    box(page, MARKUP).check()
    box(page, "Random").check()
    # A long name is broken into lines within its column.
    inside = "one.getBoundingClientRect().right <= one.closest('td').getBoundingClientRect().right"
    assert all(measured(page, "#view-compare td .named", inside))
    # Two pilots at most.
    expect(box(page, "Greedy")).to_be_disabled()
    box(page, MARKUP).uncheck()
    box(page, "Greedy").check()
    expect(page).to_have_url(re.compile("task=easy&pilots=greedy,random$"))
    pairing = get(server, "paired/easy", a="greedy", b="random")
    facts = page.locator("dl.paired")
    expect(facts).to_contain_text(" to ".join(f"+{fixed(bound * 100, 1)}" for bound in pairing["ci95"]))
    expect(facts.locator("dd").nth(2)).to_have_text(str(pairing["wins"]))
    first = max(pairing["pairs"], key=lambda pair: (abs(pair["difference"]), -pair["a"]["seed"]))["a"]
    expect(rows(page, "Greedy against Random").first.locator("td").first).to_have_text(str(first["seed"]))
    page.get_by_role("link", name=f"Fly both over map {first['seed']}", exact=True).click()
    expect(page).to_have_url(f"{server.url}/?task=easy&seed={first['seed']}&pilots=greedy,random")


def test_a_tick_moves_no_row_and_people_with_few_maps_are_last(page: Page, server: Server) -> None:
    people = [Provenance(pilot="human", person=f"Person-{number}") for number in range(30)]
    flights = [flown("city_small", 5, "greedy", one) for one in (None, *people)]
    fill(server.data, [flown("city_small", 5, "random"), *flights])
    compare(page, "city_small")
    lines, ticked = rows(page, "Leaderboard"), page.get_by_role("checkbox", checked=True)
    expect(lines).to_have_count(32)
    expect(lines.nth(0)).to_contain_text("Greedy")
    expect(lines.nth(1)).to_contain_text("Random")

    def places() -> list[float]:
        return measured(page, "#view-compare input[type=checkbox]", "one.offsetTop")

    before = places()
    for name, count in (("Greedy", 1), ("Person-7", 2)):
        box(page, name).click()
        expect(page).to_have_url(re.compile(name.lower() if count == 1 else "Person-7"))
        expect(ticked).to_have_count(count)
        assert places() == before
    expect(page.locator("dl.paired")).to_contain_text("Person-7 scores higher")
    box(page, "Person-7").uncheck()
    expect(page).to_have_url(re.compile("pilot=greedy$"))
    expect(rows(page, "Maps of Greedy")).to_have_count(1)
    # A person has one spelling, and one colour.
    newest = rows(page, "Flights, newest first").first
    expect(newest.locator("td").first).to_have_text("Person-29")
    colour = next(one["colour"] for one in get(server, "pilots")["pilots"] if one["id"] == "human")
    for line in (newest, lines.filter(has_text="Person-29")):
        expect(line.locator(".dot")).to_have_attribute("style", f"--colour: var(--pilot-{colour});")
    newest.get_by_role("link").click()
    expect(page.locator("#results-title")).to_have_text(re.compile("^Person-29: "))


def test_runs_of_models(page: Page, server: Server) -> None:
    compare(page)
    run = get(server, "leaderboard/easy/runs")["boards"][0]["rows"][0]
    lines = rows(page, "Runs over maps 14 to 15 (custom)")
    expect(lines).to_have_count(2)
    # A pilot has the name and the colour that it has everywhere.
    expect(lines.last).to_contain_text("Random")
    colours = {one["id"]: one["colour"] for one in get(server, "pilots")["pilots"]}
    expect(lines.last.locator(".dot")).to_have_attribute("style", f"--colour: var(--pilot-{colours['random']});")
    for text in (run["agent"], run["prompt"], points(run["score"])):
        expect(lines.first).to_contain_text(text)
    page.get_by_role("link", name="scripted by minimal-2").click()
    maps = get(server, "leaderboard/easy/maps", agent="scripted", run="run")["maps"]
    page.get_by_role("link", name="Open the flight of scripted over map 15", exact=True).click()
    expect(page).to_have_url(f"{server.url}/?episode={maps[1]['id']}")


def test_a_flight_that_ends_elsewhere_appears_by_itself(page: Page, server: Server) -> None:
    compare(page, "hard")
    with Store(server.data) as store:
        episode = replay(flown("hard", SEEDS, "greedy"))
        new = [store.add_episode(episode, "else, where") for _ in range(2)]
    expect(page.locator(f"[href='?episode={new[1]}']")).to_be_visible()
    # The address keeps a name with a comma whole.
    page.get_by_role("link", name="else, where", exact=True).click()
    expect(page).to_have_url(re.compile(r"pilot=else%2C%20where$"))
    expect(rows(page, "Maps of else, where")).to_have_count(1)


@pytest.mark.parametrize("heard", ["before", "after"])
def test_a_flight_that_ends_while_the_view_loads_appears(page: Page, server: Server, heard: str) -> None:
    """Its news arrive before or after a leaderboard that does not contain it yet."""
    compare(page)
    # Later news are not about an optimum of another flight.
    until(page, lambda: all(one["optimal_score"] for one in get(server, "episodes", task="easy")["episodes"]))
    paths = {"news": r"episodes\?limit=", "list": r"episodes\?task=medium&", "board": "leaderboard/medium$"}
    held: dict[str, Route] = {}
    holding = {*paths}

    def arrived(name: str, route: Route) -> None:
        if name in holding:
            held[name] = route
        else:
            route.continue_()

    for name, path in paths.items():
        page.route(re.compile(path), lambda route, _, name=name: arrived(name, route))

    def release(name: str) -> None:
        until(page, lambda: name in held)
        with page.expect_response(held[name].request.url):
            held[name].continue_()

    compare(page, "medium")
    until(page, lambda: "list" in held)
    # A board that the page asks for together with the list is here when the page draws next.
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    together = "board" in held
    if not together:
        release("list")
    until(page, lambda: "board" in held)
    board = held["board"]
    answer = board.fetch()
    new = fill(server.data, [flown("medium", SEEDS, "greedy", label=f"news {heard}")])[0]
    if together:
        release("list")
    if heard == "before":
        release("news")
    holding -= {"list", "board"}
    board.fulfill(response=answer)
    expect(page.locator(".compare-parts")).to_have_js_property("inert", False)
    if heard == "after":
        release("news")
    page.unroute_all()
    expect(page.locator(f"[href='?episode={new}']")).to_be_visible()
    expect(page.get_by_role("link", name=f"news {heard}", exact=True)).to_be_visible()
