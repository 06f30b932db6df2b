"""Links: the address is what the page shows, for live and past flights and for views; odd ones, and the way back."""

import re
from collections.abc import Callable
from urllib.parse import unquote

import pytest
from playwright.sync_api import Page, Route, expect

from tests.api.serving import Server
from tests.browser.flights import fill, flown, frames, newest
from tests.browser.shown import counter, expect_flying, expect_frame, expect_step
from tests.browser.stage import (
    along,
    at_speed,
    choices,
    ended,
    fly,
    keys,
    map_number,
    open_file,
    over,
    pilot,
    press,
    show,
    slider,
    until,
    view,
)
from tests.browser.tabs import Tabs

PAGE_BYTES = 300_000
MOST_FILES = 20
MOST_SHIFT = 0.02
"""Google rates a page as good up to 0.1."""


def test_a_link_opens_exactly_its_flight(page: Page, beside: Callable[..., Page], server: Server) -> None:
    show(page, "/?task=easy&seed=7&pilot=greedy")
    expect(map_number(page)).to_have_value("7")
    expect(page).to_have_title("Easy · map 7 · Greedy · Drone Delivery")
    press(page, "New map")
    expect(map_number(page)).not_to_have_value(re.compile("^7?$"))
    seed = map_number(page).input_value()
    along(page, "Optimal").check()
    expect(page).to_have_url(re.compile(f"seed={seed}&pilots=greedy,optimal"))
    page.go_back()
    expect_flying(page, "Greedy")
    expect(map_number(page)).to_have_value(seed)
    page.go_back()
    expect(map_number(page)).to_have_value("7")
    page.go_forward()
    page.go_forward()
    expect_flying(page, "Greedy", "Optimal")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    press(page, "Copy link to this moment")
    expect(page.locator("#toasts")).to_contain_text("Link copied.")
    link = page.evaluate("navigator.clipboard.readText()")
    assert link == f"{server.url}/?task=easy&seed={seed}&pilots=greedy,optimal"
    other = beside(f"{link}&profile=composite")
    expect_flying(other, "Greedy", "Optimal")
    fly(other)
    ended(other)
    # The two tabs have a flight each.
    expect_step(page, 0, 60)
    assert newest(server, int(seed))["reward_profile"] == "composite"


def test_the_address_changes_at_once_and_then_only_when_the_browser_allows_it(page: Page) -> None:
    show(page, "/?view=learn")
    said = page.evaluate("""async () => {
        const { Router } = await import(new URL("static/js/router.js", document.baseURI));
        const router = new Router();
        return [3, 4, null].map((step) => {
            if (step === null) window.dispatchEvent(new Event("pagehide"));
            else router.moment({ step });
            return new URLSearchParams(location.search).get("step");
        });
    }""")
    assert said == ["3", "3", "4"]


def test_a_link_opens_a_moment_which_the_address_goes_on_to_say(page: Page, server: Server) -> None:
    flights = [frames(server, flown("medium", 7, agent)) for agent in ("greedy", "random")]
    over(page, 7, "/?task=medium&seed=7&pilots=greedy,random&step=9")
    for key, flight in (("2", flights[1]), ("1", flights[0])):
        page.keyboard.press(key)
        expect_frame(page, flight[9], 100)
    press(page, "Step")
    expect_frame(page, flights[0][10], 100)
    slider(page).fill("4")
    expect(page).to_have_url(re.compile("seed=7&pilots=greedy,random&step=4$"))
    # To look back is no alarm.
    expect(page.locator("#step-counter")).to_have_css("color", page.evaluate("getComputedStyle(document.body).color"))
    page.reload()
    expect_frame(page, flights[0][4], 100)
    # The address follows a flight that flies by itself.
    at_speed(page, "2")
    press(page, "Resume")
    expect(page).to_have_url(re.compile("&step=[5-9]$"))
    press(page, "Pause")
    expect(page.get_by_role("button", name="Resume", exact=True)).to_be_visible()
    at = counter(page)
    page.reload()
    expect_frame(page, flights[0][at], 100)
    expect(page.get_by_role("button", name="Resume", exact=True)).to_be_enabled()


def test_back_and_reload_show_the_view_and_the_flight_that_the_address_says(page: Page, server: Server) -> None:
    # Both in the middle of their flights: the moments differ from their ends.
    records = [flown("medium", seed, "random") for seed in (5, 6)]
    ids = fill(server.data, records)
    moments = [frames(server, record) for record in records]

    def expect_stored(number: int, at: int) -> None:
        expect_frame(page, moments[number][at], 100)
        expect(map_number(page)).to_have_value(str(records[number].seed))
        end = moments[number][at]["done"]
        expect(page).to_have_url(f"{server.url}/?episode={ids[number]}" + ("" if end else f"&step={at}"))

    show(page, f"/?episode={ids[0]}&step=7")
    expect_stored(0, 7)
    press(page, "Step")
    expect_stored(0, 8)
    expect(page.locator(".results")).to_contain_text("Random: ")
    view(page, "Compare")
    show(page, f"/?episode={ids[1]}")
    # Beside its results stands its end, unless another step is named.
    expect_stored(1, len(moments[1]) - 1)
    press(page, "First step")
    expect_stored(1, 0)
    page.go_back()
    expect(page).to_have_title("Compare pilots · Drone Delivery")
    expect(page.locator("#view-fly")).to_be_hidden()
    page.go_back()
    expect_stored(0, 8)
    page.reload()
    expect_stored(0, 8)
    # The link in the navigation comes back to the last flight.
    view(page, "Learn")
    view(page, "Fly")
    expect_stored(0, 8)


def test_a_flight_of_ones_own_that_is_left_goes_on_where_it_was(page: Page, server: Server) -> None:
    show(page, "/?task=easy&seed=9&pilot=greedy")
    expect(map_number(page)).to_have_value("9")
    pilot(page, "You").click()
    expect_flying(page, "You")
    keys(page, *[" "] * 3)
    expect(page).to_have_url(f"{server.url}/?task=easy&seed=9&pilot=human&of=human&actions=WWW")
    view(page, "API")
    # Keys do not fly a flight that is hidden.
    page.keyboard.press("ArrowUp")
    page.go_back()
    page.go_back()
    expect_flying(page, "Greedy")
    expect_step(page, 0, 60)
    page.go_forward()
    expect_step(page, 3, 60, "WAIT")
    expect_flying(page, "You")
    press(page, "Undo")
    expect(page).to_have_url(f"{server.url}/?task=easy&seed=9&pilot=human&of=human~~u&actions=WW")
    page.reload()
    expect_step(page, 2, 60, "WAIT")
    # At the end the address leads to the stored flight.
    keys(page, *[" "] * 58)
    expect(page).to_have_url(re.compile(r"/\?episode=\w+&task=easy&seed=9&pilot=human$"))
    expect_step(page, 60, 60, "WAIT")
    expect(page.locator("#results-title")).to_have_text("You: Battery empty.")
    page.reload()
    expect_step(page, 60, 60, "WAIT")
    expect(page.locator("#results-title")).to_have_text("You: Battery empty.")


@pytest.mark.long
def test_a_flight_of_a_file_has_an_address_which_its_tab_shows_again(
    page: Page, beside: Callable[..., Page], server: Server
) -> None:
    records = [flown("medium", seed, "random") for seed in (5, 6)]
    moments = [frames(server, record) for record in records]
    view(page, "Fly")
    open_file(page, "two flights.jsonl", "".join(record.to_json() + "\n" for record in records))
    expect_frame(page, moments[0][-1], 100)
    choices(page).get_by_role("combobox", name="Flight of the file").select_option(index=1)
    expect_frame(page, moments[1][-1], 100)
    slider(page).fill("4")
    expect(page).to_have_url(re.compile(r"/\?file=two%20flights\.jsonl~\w+&step=4&selected=2$"))
    page.reload()
    expect_frame(page, moments[1][4], 100)
    view(page, "Learn")
    view(page, "Fly")
    expect_frame(page, moments[1][4], 100)
    other = beside(page.url)
    gone = "This tab does not have two flights.jsonl any more. Open the file again."
    expect(other.locator(".problem:visible")).to_contain_text(gone)
    show(other, "/?view=draw&file=a.toml~1")
    expect(other.locator("#view-draw").get_by_role("alert")).to_have_text(gone.replace("two flights.jsonl", "a.toml"))
    show(page, page.url.replace("selected=2", "selected=3"))
    expect(page.locator(".problem:visible")).to_contain_text(
        "two flights.jsonl contains 2 flights, none with number 3."
    )
    page.evaluate("history.go(-4)")
    expect_frame(page, moments[0][-1], 100)


def test_the_address_of_a_flight_of_ones_own_contains_its_moves(beside: Callable[..., Page], server: Server) -> None:
    page = beside("/")
    hello = page.locator("#hello")
    hello.get_by_role("link", name="Fly it yourself").click()
    expect_step(page, 0, 60)
    page.keyboard.press(" ")
    expect(page).to_have_url(re.compile("actions=W$"))
    own = page.url
    pilot(page, "Greedy").click()
    press(page, "Give up")
    pilot(page, "You").click()
    expect_flying(page, "You")
    keys(page, *[" "] * 2)
    expect(page).to_have_url(re.compile("actions=WW$"))
    # Two entries differ by their moves alone.
    page.evaluate("history.go(-2)")
    expect_step(page, 1, 60, "WAIT")
    expect(page).to_have_url(own)
    page.go_back()
    expect(hello).to_be_visible()
    expect(page).to_have_url(f"{server.url}/")
    # The page completes a shorter address.
    show(page, "/?task=skyline_easy&pilot=human")
    expect(page).to_have_url(re.compile(r"/\?task=skyline_easy&seed=\d+&pilot=human$"))


@pytest.mark.long
def test_odd_links_say_what_is_not_understood_and_refused_ones_offer_another(page: Page, shared: Tabs) -> None:
    shared.expect("404|422")
    show(page, "/?view=nosuch&task=easy&seed=6&pilot=greedy&fork=junk&step=-3")
    unread = "The link contains invalid values, which were ignored: view=nosuch, step=-3, fork=junk."
    expect(page.locator("#toasts .toast").last).to_have_text(unread)
    expect(map_number(page)).to_have_value("6")
    show(page, "/?task=hard&seed=6&pilots=greedy,human&lesson=4")
    expect(page.locator("#toasts .toast").last).to_have_text("There is no lesson 4: the lessons are 1 to 3.")
    # Nor do those of somebody whom the link does not say, or not whole.
    for damaged in ("", "human~Ada~x"):
        show(page, f"/?task=hard&seed=6&pilots=greedy,human&fork=2&of={damaged}&actions=UL")
        expect(page.locator("#toasts .toast").last).to_contain_text(f"ignored: of={unquote(damaged)}.")
        expect_step(page, 0, 160)
    # Unknown or missing moves are ignored, too.
    for fork, moves, why in (
        (2, "UX", "moves are U, D, L, R and W"),
        (3, "UL", "fork=3 needs all 3 moves from step 0"),
    ):
        show(page, f"/?task=hard&seed=6&pilots=greedy,human&fork={fork}&of=greedy&actions={moves}")
        expect(page.locator("#toasts .toast").last).to_contain_text(f"ignored: actions={moves} ({why}).")
        expect_step(page, 0, 160)
    problem, start = page.locator(".problem:visible"), page.get_by_role("button", name="Start", exact=True)
    # A refused start keeps the flights that are shown; Back leads to them.
    expect(page).to_have_url(re.compile(r"pilots=greedy,human$"))
    shown = page.url
    show(page, "/?task=easy&seed=-4")
    expect(problem).to_have_text("The number of the map: Input should be greater than or equal to 0")
    page.go_back()
    expect(problem).to_be_hidden()
    expect_step(page, 0, 160)
    expect(page).to_have_url(shown)
    show(page, f"/?view=draw&task=easy&seed={10**400}")
    too_large = "The number of the map: Input should be less than or equal to 9007199254740991"
    expect(problem.filter(has_text=too_large)).to_be_visible()
    show(page, "/?view=compare&task=zzz")
    expect(problem.filter(has_text="Unknown task 'zzz'; allowed: ")).to_be_visible()
    unstored = "This server does not have Drawn map 0123. Open its file in Draw."
    show(page, "/?view=compare&task=drawn_0123456789ab")
    expect(problem.filter(has_text=unstored)).to_be_visible()
    for link, why in (
        (
            f"/?task=hard&seed=7&pilots={','.join(['greedy'] * 9)}",
            "Pilots: List should have at most 8 items after validation, not 9",
        ),
        ("/?episode=nothing", "There is no episode 'nothing'"),
    ):
        page.goto(link)
        expect(problem).to_contain_text(why)
        expect(problem).not_to_contain_text(re.compile("--|DRONE_ENV"))  # the hints of the command line
        expect(start).to_have_count(0)
        expect(page.get_by_role("button", name="Copy link")).to_be_disabled()
        press(page, "New map" if "seed" in link else "Fly another map")
        expect(start).to_be_enabled()
        expect(page).to_have_url(re.compile(r"\?task=[a-z_]+&seed=[0-9]{1,4}&pilot="))


def test_the_bare_address_is_light_and_shows_a_flight_until_one_is_flown(beside: Callable[..., Page]) -> None:
    page = beside()
    page.goto("/")
    hello = page.locator("#hello")
    expect(hello.get_by_role("link", name="Race the network")).to_be_visible()
    expect_step(page, 0, 100)
    page.wait_for_load_state("networkidle")
    sizes: dict[str, int] = page.evaluate(
        """async () => {
            const loaded = ["navigation", "resource"].flatMap(type => performance.getEntriesByType(type))
                .filter(({ name }) => !/values|flights/.test(name));  // asked for once the page is there
            const size = async ({ name }) => [name, (await (await fetch(name)).arrayBuffer()).byteLength];
            return Object.fromEntries(await Promise.all(loaded.map(size)));
        }"""
    )
    assert [url for url in sizes if not url.startswith(page.url)] == []
    assert f"{page.url}tasks" in sizes, sorted(sizes)
    assert len(sizes) <= MOST_FILES, sorted(sizes)
    assert sum(sizes.values()) < PAGE_BYTES, sorted(sizes.items(), key=lambda pair: -pair[1])[:10]
    # Nothing moves while it loads.
    shifts: list[float] = page.evaluate(
        """() => new Promise(done => new PerformanceObserver(list => done(list.getEntries().map(({ value }) => value)))
            .observe({ type: "layout-shift", buffered: true }) || setTimeout(done, 500, []))"""
    )
    assert sum(shifts) <= MOST_SHIFT, shifts
    seed = hello.get_attribute("data-seed")
    assert seed
    # The map that is drawn there is the one that is flown.
    expect(map_number(page)).to_have_value(seed)
    expect(hello).to_be_visible()
    bare = page.url
    press(page, "Step")
    expect(hello).to_be_hidden()
    expect_step(page, 1, 100)
    expect(page).to_have_url(re.compile(f"seed={seed}&pilot=[^&]+&step=1$"))
    page.go_back()
    expect(hello).to_be_visible()
    expect(page).to_have_url(bare)


def test_a_click_before_the_page_has_started_loads_nothing_again(beside: Callable[..., Page]) -> None:
    page, held = beside(), list[Route]()
    page.route("**/tasks", lambda route, _: held.append(route))
    page.goto("/")
    hello = page.locator("#hello")
    hello.get_by_role("link", name="Fly it yourself").click()
    expect(page.locator("#view-fly")).to_have_text("Loading the page …")
    expect(hello).to_be_visible()
    until(page, lambda: bool(held))
    held[0].continue_()
    expect_flying(page, "You")
    assert len(held) == 1
