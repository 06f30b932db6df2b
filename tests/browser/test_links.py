"""Links: the address is what the page shows, for live and past flights and for views; odd ones, and the way back."""

import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, expect

from drone_env.core.tasks import get_task
from tests.api.networks import put_trained
from tests.api.serving import Server
from tests.browser.flights import fill, flown, frames
from tests.browser.shown import expect_frame
from tests.browser.stage import along, ended, fly, over, pilot, show, step, view
from tests.browser.tabs import Tabs


def map_number(page: Page) -> Locator:
    return page.get_by_role("spinbutton", name="Map")


def expect_flying(page: Page, *names: str) -> None:
    expect(page.get_by_role("group", name="Pilots").locator("button[aria-pressed=true]")).to_have_text(names)


def test_a_link_opens_exactly_its_flight(page: Page, beside: Callable[[str], Page], server: Server) -> None:
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    show(page, "/?task=easy&seed=7&pilot=greedy")
    expect(map_number(page)).to_have_value("7")
    page.get_by_role("button", name="New map").click()
    expect(map_number(page)).not_to_have_value(re.compile("^7?$"))
    pilot(page, "Optimal").click()
    expect(page).to_have_url(re.compile("pilot=optimal"))
    page.get_by_role("combobox", name="Rewards").select_option("composite")
    expect(page).to_have_url(re.compile("profile=composite"))
    seed = map_number(page).input_value()
    page.get_by_role("button", name="Copy link to this moment").click()
    expect(page.locator("#toasts")).to_contain_text("Link copied.")
    link = page.evaluate("navigator.clipboard.readText()")
    assert link == f"{server.url}/?task=easy&seed={seed}&pilot=optimal&profile=composite"
    other = beside(link)
    expect(map_number(other)).to_have_value(seed)
    expect_flying(other, "Optimal")
    expect(other.get_by_role("radio", name="Easy", exact=True)).to_be_checked()
    expect(other.get_by_role("combobox", name="Rewards")).to_have_value("composite")
    fly(other)
    ended(other)
    stored = server.client.get("/episodes", params={"task": "easy", "agent": "optimal"}).json()["episodes"][0]
    assert (stored["seed"], stored["reward_profile"]) == (int(seed), "composite")


def test_a_link_opens_a_moment_which_the_address_goes_on_to_say(page: Page, server: Server) -> None:
    flights = [frames(server, flown("medium", 7, agent)) for agent in ("greedy", "random")]
    over(page, 7, "/?task=medium&seed=7&pilots=greedy,random&step=9")
    expect_frame(page, flights[0][9], 100)
    for key, flight in (("2", flights[1]), ("1", flights[0])):
        page.keyboard.press(key)
        expect_frame(page, flight[9], 100)
    # It goes on from there, and what was flown is looked back at.
    step(page)
    expect_frame(page, flights[0][10], 100)
    page.get_by_role("slider", name="Step of the flight").fill("4")
    expect_frame(page, flights[0][4], 100)
    here = f"{server.url}/?task=medium&seed=7&pilots=greedy,random&step=4&flown=10"
    expect(page).to_have_url(here)
    page.reload()
    expect_frame(page, flights[0][4], 100)
    expect(page).to_have_url(here)
    page.get_by_role("button", name="Last step").click()
    expect_frame(page, flights[0][10], 100)
    expect(page).to_have_url(here.replace("4&flown=10", "10"))
    # A moment that is not there is the last one.
    last = len(flights[0]) - 1
    show(page, "/?task=medium&seed=7&pilot=greedy&step=99")
    expect_frame(page, flights[0][last], 100)
    expect(page).to_have_url(re.compile(f"pilot=greedy&step={last}$"))
    page.go_back()
    expect_frame(page, flights[0][10], 100)
    expect_flying(page, "Greedy", "Random")
    # A person has not flown yet: there is no moment but the start.
    show(page, "/?task=medium&seed=7&pilot=human&step=9")
    expect_frame(page, flights[0][0], 100)
    expect(page).to_have_url(re.compile("pilot=human$"))


def test_each_flight_is_an_entry_that_back_and_forward_come_to(page: Page) -> None:
    show(page, "/?task=easy&seed=7&pilot=greedy")
    expect(map_number(page)).to_have_value("7")
    page.get_by_role("button", name="New map").click()
    expect(map_number(page)).not_to_have_value(re.compile("^7?$"))
    seed = map_number(page).input_value()
    along(page, "Optimal").check()
    expect(page).to_have_url(re.compile(f"seed={seed}&pilots=greedy,optimal"))
    page.go_back()
    expect_flying(page, "Greedy")
    expect(map_number(page)).to_have_value(seed)
    page.go_back()
    expect(map_number(page)).to_have_value("7")
    expect(page).to_have_url(re.compile("seed=7&pilot=greedy$"))
    page.go_forward()
    page.go_forward()
    expect_flying(page, "Greedy", "Optimal")
    expect(map_number(page)).to_have_value(seed)


def test_back_and_reload_show_the_view_and_the_flight_that_the_address_says(page: Page, server: Server) -> None:
    # Both in the middle of their flights: a moment that another does not have would not be told apart from its end.
    first, second = flown("medium", 5, "random"), flown("medium", 6, "random")
    ids = fill(server.data, [first, second])
    shown = {id_: frames(server, one) for id_, one in zip(ids, (first, second), strict=True)}

    def expect_stored(id_: str, at: int, seed: int) -> None:
        expect(map_number(page)).to_have_value(str(seed))
        expect_frame(page, shown[id_][at], 100)
        expect(page).to_have_url(f"{server.url}/?episode={id_}" + (f"&step={at}" if at else ""))

    over(page, 5, f"/?episode={ids[0]}&step=8")
    expect_stored(ids[0], 8, 5)
    view(page, "Compare")
    expect(page).to_have_url(f"{server.url}/?view=compare")
    expect(page).to_have_title("Compare pilots · Drone Delivery")
    show(page, f"/?episode={ids[1]}")
    expect_stored(ids[1], 0, 6)
    page.go_back()
    expect(page).to_have_title("Compare pilots · Drone Delivery")
    expect(page.locator("#view-fly")).to_be_hidden()
    page.go_back()
    expect(page).to_have_title("Fly · Drone Delivery")
    expect_stored(ids[0], 8, 5)
    page.reload()
    expect_stored(ids[0], 8, 5)
    # The links above come back to what stood there last.
    view(page, "Learn")
    expect(page).to_have_url(f"{server.url}/?view=learn")
    view(page, "Fly")
    expect_stored(ids[0], 8, 5)


def test_a_flight_of_ones_own_that_is_left_goes_on_where_it_was(page: Page, server: Server) -> None:
    where = page.locator("#step-counter")
    show(page, "/?task=easy&seed=9&pilot=greedy")
    expect(map_number(page)).to_have_value("9")
    pilot(page, "You").click()
    expect(page).to_have_url(f"{server.url}/?task=easy&seed=9&pilot=human")
    own = f"{server.url}/?task=easy&seed=9&pilot=human&of=human&actions=WWW"
    for _ in range(3):
        page.keyboard.press(" ")
    expect(page).to_have_url(own)
    page.go_back()
    expect_flying(page, "Greedy")
    expect(where).to_have_text("Step 0 of 60")
    page.go_forward()
    expect(where).to_have_text(re.compile("^Step 3 of 60 · WAIT"))
    expect_flying(page, "You")
    # As it was: what he has asked for and taken back is not forgotten.
    page.get_by_role("button", name="Undo").click()
    expect(page).to_have_url(f"{server.url}/?task=easy&seed=9&pilot=human&of=human%20with%20undo&actions=WW")
    page.get_by_role("button", name="First step").click()
    expect(page).to_have_url(re.compile("actions=WW&step=0$"))
    page.reload()
    expect(where).to_have_text("Step 0 of 60")
    page.keyboard.press(" ")
    expect(where).to_have_text(re.compile("^Step 3 of 60 · WAIT"))
    # Once it has ended the address leads to what is kept of it.
    for _ in range(57):
        page.keyboard.press(" ")
    expect(page).to_have_url(re.compile(r"/\?episode=\w+&task=easy&seed=9&pilot=human&step=60$"))
    page.reload()
    expect(page.locator(".strip")).to_contain_text("You")
    expect(where).to_have_text(re.compile("^Step 60 of 60"))
    known = server.client.get("/episodes", params={"agent": "human with undo"}).json()["episodes"]
    assert len([one for one in known if one["seed"] == 9]) == 1


def test_a_flight_of_ones_own_is_still_there_after_others_were_looked_at(page: Page, server: Server) -> None:
    id_ = fill(server.data, [flown("easy", 6, "random")])[0]
    show(page, "/?task=easy&seed=7&pilot=human")
    where = page.locator("#step-counter")
    expect(where).to_have_text("Step 0 of 60")
    for at in (1, 2):
        page.keyboard.press(" ")
        expect(where).to_have_text(re.compile(f"^Step {at} of 60"))
    view(page, "API")
    # It is not on the page that is shown: keys do not fly it.
    page.keyboard.press("ArrowUp")
    show(page, f"/?episode={id_}")
    expect(map_number(page)).to_have_value("6")
    page.keyboard.press("ArrowRight")
    expect(where).to_have_text(re.compile("^Step 1 of [0-9]+"))
    page.go_back()
    page.go_back()
    expect(map_number(page)).to_have_value("7")
    expect(where).to_have_text(re.compile("^Step 2 of 60 · WAIT"))
    page.keyboard.press(" ")
    expect(where).to_have_text(re.compile("^Step 3 of 60"))


def test_links_of_earlier_versions_and_odd_ones_open_a_view_with_the_way_to_the_others_in_sight(
    page: Page, shared: Tabs
) -> None:
    current = page.get_by_role("navigation", name="Views").locator("[aria-current]")

    def expect_view(name: str) -> None:
        expect(page).to_have_title(f"{name} · Drone Delivery")
        expect(current).to_have_text(name.split()[0])
        expect(current).to_be_in_viewport()
        assert page.evaluate("scrollY") == 0

    page.goto("about:blank")  # what follows a # alone is no other page
    page.goto("/#specs")
    expect_view("Learn")
    for link, name in (
        ("/#history", "Compare pilots"),
        ("/?view=specs", "Learn"),
        ("/?view=logs", "API and logs"),
        ("/?view=constructor#toString", "Fly"),
        ("/#replay", "Fly"),
    ):
        show(page, link)
        expect_view(name)
    show(page, "/?view=race&task=easy&seed=5&pilots=greedy,random")
    expect_view("Fly")
    expect_flying(page, "Greedy", "Random")
    expect(map_number(page)).to_have_value("5")
    show(page, "/?episode=&pilots=,,&task=&seed=#nothing")
    expect_view("Fly")
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 0 of"))
    told = page.locator("#toasts .toast")
    expect(told).to_have_count(0)
    show(page, "/?view=nosuch&task=easy&seed=6&pilot=greedy&fork=junk&step=-3&lesson=99")
    lesson = told.filter(has_text="There is no lesson 99: they are 1 to 3.")
    expect(told.first).to_have_text(
        "Not understood in the address: view=nosuch, step=-3, fork=junk. The rest of it is shown."
    )
    expect(lesson).to_be_visible()
    expect_view("Fly")
    expect(map_number(page)).to_have_value("6")
    page.locator("#toasts").evaluate("toasts => toasts.replaceChildren()")
    show(page, "/?view=compare&task=easy&pilots=random,greedy,optimal")
    expect(told).to_have_text("2 pilots are compared at a time: without optimal.")
    expect(page.get_by_role("heading", name="Random against Greedy")).to_be_visible()
    shared.expect("404")
    show(page, "/?view=compare&task=zzz")
    expect(page.get_by_role("alert").filter(has_text="unknown task 'zzz'; allowed: ")).to_be_visible()
    expect(page.get_by_role("combobox", name="Task")).to_have_value("")
    expect(page.get_by_role("region", name="Leaderboard")).to_be_hidden()
    page.get_by_role("combobox", name="Task").select_option("easy")
    expect(page.get_by_role("region", name="Leaderboard")).to_be_visible()


@pytest.mark.feature("L7")
def test_where_no_pilot_is_named_the_network_that_was_trained_here_flies(page: Page, server: Server) -> None:
    file = put_trained(get_task("easy"), server.data)
    try:
        page.goto("/?task=easy")
        expect_flying(page, "Trained here")
        expect(page).to_have_url(re.compile("pilot=trained"))
        expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
        # What it cannot fly, the shipped one does.
        page.get_by_role("radio", name="Medium", exact=True).check()
        expect_flying(page, "PathQNet")
        expect(pilot(page, "Trained here")).to_be_disabled()
    finally:
        file.unlink()
    page.goto("/?task=easy")
    expect_flying(page, "PathQNet")
    expect(pilot(page, "Trained here")).to_have_count(0)


def test_a_link_that_is_refused_says_why_and_offers_another(page: Page, shared: Tabs) -> None:
    shared.expect("404")
    problem = page.get_by_role("alert")
    for link, why in (
        ("/?task=hard&seed=7&pilots=pathqnet,greedy,optimal,random,human", "at most 4 fly at once, not 5"),
        ("/?episode=nothing", "nothing"),
    ):
        page.goto(link)
        expect(problem).to_contain_text(why)
        expect(page.get_by_role("button", name="Start", exact=True)).to_have_count(0)
        page.get_by_role("button", name="Fly another map").click()
        expect(page.get_by_role("button", name="Start", exact=True)).to_be_enabled()
        expect(problem).to_be_hidden()
        expect(page).to_have_url(re.compile(r"\?task=[a-z_]+&seed=[0-9]{1,4}&pilot="))
    show(page, "/?task=nowhere&seed=7")
    expect(problem).to_contain_text("nowhere")


def test_the_bare_address_has_a_flight_that_moves_by_itself_until_one_is_flown(
    beside: Callable[[str], Page], shared: Tabs
) -> None:
    shared.expect("was preloaded")  # for the script that is kept out at first
    page = beside("")
    page.emulate_media(reduced_motion="no-preference")
    page.route("**/main.js", lambda route: route.fulfill(body="", content_type="text/javascript"))
    page.goto("/")
    drone = page.locator("#hello .hello-drone")
    places = {str(drone.bounding_box()) for _ in range(5) if not page.wait_for_timeout(100)}
    assert len(places) > 1, "it moves without a script"
    page.emulate_media(reduced_motion="reduce")
    assert drone.evaluate("drone => drone.getAnimations().length") == 0
    page.unroute("**/main.js")
    page.goto("/")
    hello, where = page.locator("#hello"), page.locator("#step-counter")
    expect(hello.get_by_role("link", name="Race the network")).to_be_visible()
    expect(where).to_have_text("Step 0 of 100")
    seed = hello.get_attribute("data-seed")
    assert seed is not None
    assert len(seed) < 5, "people say the number to each other"
    # The map that is drawn there is the one that is flown.
    expect(map_number(page)).to_have_value(seed)
    expect(hello).to_be_visible()
    bare = page.url
    step(page)
    expect(hello).to_be_hidden()
    expect(where).to_have_text(re.compile("^Step 1 of 100"))
    expect(page).to_have_url(re.compile(f"seed={seed}&pilot=[^&]+&step=1$"))
    page.go_back()
    expect(hello).to_be_visible()
    expect(where).to_have_text("Step 0 of 100")
    expect(page).to_have_url(bare)
    view(page, "Learn")
    expect(hello).to_be_hidden()
    page.go_back()
    # What lies there once the greeting has gone is not meant by the second half of a double click.
    hello.get_by_role("link", name="Fly it yourself").dblclick()
    expect(where).to_have_text("Step 0 of 100")
    expect_flying(page, "You")
    expect(map_number(page)).to_have_value(seed)
    expect(hello).to_be_hidden()
