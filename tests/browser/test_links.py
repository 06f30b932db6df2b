"""Links: what they open, odd ones, and the way back."""

import re
from collections.abc import Callable

import httpx
import pytest
from playwright.sync_api import Page, expect

from drone_env.core.tasks import get_task
from tests.api.networks import put_trained
from tests.api.serving import Server
from tests.browser.stage import fly, results, view
from tests.browser.tabs import Tabs


def test_a_link_opens_exactly_its_mission(page: Page, beside: Callable[[str], Page], server: Server) -> None:
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.goto("/?task=easy&seed=7&pilot=greedy")
    page.get_by_role("button", name="New map").click()
    expect(page.get_by_role("spinbutton", name="Map")).not_to_have_value(re.compile("^7?$"))
    page.get_by_role("radio", name="Optimal").check()
    expect(page).to_have_url(re.compile("pilot=optimal"))
    page.get_by_role("combobox", name="Rewards").select_option("composite")
    expect(page).to_have_url(re.compile("profile=composite"))
    seed = page.get_by_role("spinbutton", name="Map").input_value()
    page.get_by_role("button", name="Copy link to this flight").click()
    expect(page.locator("#toasts")).to_contain_text("Link copied.")
    link = page.evaluate("navigator.clipboard.readText()")
    assert link == f"{server.url}/?task=easy&seed={seed}&pilot=optimal&profile=composite"
    other = beside(link)
    expect(other.get_by_role("spinbutton", name="Map")).to_have_value(seed)
    expect(other.get_by_role("radio", name="Optimal")).to_be_checked()
    expect(other.get_by_role("radio", name="Easy", exact=True)).to_be_checked()
    expect(other.get_by_role("combobox", name="Rewards")).to_have_value("composite")
    fly(other)
    results(other)
    stored = httpx.get(f"{server.url}/episodes", params={"task": "easy", "agent": "optimal"}).json()["episodes"][0]
    assert (stored["seed"], stored["reward_profile"]) == (int(seed), "composite")


@pytest.mark.parametrize("link", ["/?view=specs", "/#specs"])
def test_a_link_to_a_view_keeps_the_way_to_the_others_in_sight(page: Page, link: str) -> None:
    page.set_viewport_size({"width": 1024, "height": 600})
    page.goto(link)
    expect(page).to_have_title("Learn · Drone Delivery")
    expect(page.locator(".specs-table").first).to_be_visible()
    assert page.evaluate("scrollY") == 0
    # What is no view is none.
    page.goto("/?view=constructor#toString")
    expect(page).to_have_title("Watch a flight · Drone Delivery")


@pytest.mark.feature("L7")
def test_where_no_pilot_is_named_the_network_that_was_trained_here_flies(page: Page, server: Server) -> None:
    file = put_trained(get_task("easy"), server.data)
    try:
        page.goto("/")
        expect(page.get_by_role("radio", name="Trained here")).to_be_checked()
        expect(page).to_have_url(re.compile("pilot=trained"))
        expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
        # What it cannot fly, the shipped one does.
        page.get_by_role("radio", name="Medium", exact=True).check()
        expect(page.get_by_role("radio", name="PathQNet")).to_be_checked()
        expect(page.get_by_role("radio", name="Trained here")).to_be_disabled()
    finally:
        file.unlink()
    page.goto("/")
    expect(page.get_by_role("radio", name="PathQNet")).to_be_checked()
    expect(page.get_by_role("radio", name="Trained here")).to_have_count(0)


@pytest.mark.parametrize("link", ["/?episode=#constructor", "/?pilots=,,#nothing"])
def test_a_link_to_nothing_opens_watch(page: Page, link: str) -> None:
    page.goto(link)
    expect(page).to_have_title("Watch a flight · Drone Delivery")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")


def test_a_link_to_no_episode_says_so(page: Page, shared: Tabs) -> None:
    shared.expect("404")
    page.goto("/?episode=nothing")
    expect(page.locator("#view-replay").get_by_role("alert")).to_contain_text("nothing")


def test_back_goes_back_though_the_link_has_changed(page: Page) -> None:
    page.goto("/?task=easy&seed=5&pilot=greedy")
    expect(page.locator(".card")).to_have_count(1)
    view(page, "Race")
    expect(page.locator(".card")).to_have_count(4)
    page.go_back()
    expect(page).to_have_title("Watch a flight · Drone Delivery")
    expect(page.locator(".card")).to_have_count(1)
    page.go_forward()
    expect(page.locator(".card")).to_have_count(4)


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
    hello = page.locator("#hello")
    expect(hello.get_by_role("link", name="Race the network")).to_be_visible()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    expect(hello).to_be_visible()
    page.get_by_role("button", name="Step", exact=True).click()
    expect(hello).to_have_count(0)
    page.goto("/")
    view(page, "Learn")
    expect(hello).to_have_count(0)
    page.goto("/")
    hello.get_by_role("link", name="Fly it yourself").click()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 100")
    expect(page.get_by_role("radio", name="You")).to_be_checked()
    expect(hello).to_have_count(0)


def test_back_and_reload_show_what_the_address_says(page: Page, server: Server) -> None:
    ids: list[str] = []
    with httpx.Client(base_url=server.url) as http:
        for seed in (5, 6):
            start = http.post("/reset", json={"task_name": "easy", "seed": seed, "agent": "visitor"}).json()
            headers = {"X-Session-Id": start["session_id"]}
            while not http.post("/step", json={"direction": "WAIT"}, headers=headers).json()["done"]:
                pass
            ids.append(http.get("/episodes", params={"agent": "visitor"}).json()["episodes"][0]["id"])
    title = page.locator(".replay-title")
    page.goto(f"/?episode={ids[0]}")
    expect(title).to_contain_text("map 5")
    view(page, "History")
    expect(page).to_have_url(f"{server.url}/?view=history")
    page.locator(f"tr[data-episode='{ids[1]}']").click()
    expect(title).to_contain_text("map 6")
    expect(page).to_have_url(f"{server.url}/?episode={ids[1]}")
    page.go_back()
    expect(page).to_have_title("History of episodes · Drone Delivery")
    page.go_back()
    expect(page).to_have_title("Replay a flight · Drone Delivery")
    expect(title).to_contain_text("map 5")
    page.reload()
    expect(title).to_contain_text("map 5")


def test_each_mission_is_an_entry_that_back_comes_to(page: Page) -> None:
    page.goto("/?task=easy&seed=7&pilot=greedy")
    number = page.get_by_role("spinbutton", name="Map")
    expect(number).to_have_value("7")
    page.get_by_role("button", name="New map").click()
    expect(number).not_to_have_value(re.compile("^7?$"))
    page.get_by_role("radio", name="Optimal").check()
    expect(page).to_have_url(re.compile("pilot=optimal"))
    page.go_back()
    expect(page.get_by_role("radio", name="Greedy")).to_be_checked()
    page.go_back()
    expect(number).to_have_value("7")
    expect(page).to_have_url(re.compile("seed=7&pilot=greedy$"))


def test_a_link_that_is_refused_says_why_and_offers_another(page: Page) -> None:
    page.goto("/?task=hard&seed=7&pilots=pathqnet,greedy,optimal,random,human")
    expect(page.get_by_role("alert")).to_contain_text("at most 4")
    page.get_by_role("button", name="Fly another map").click()
    expect(page.locator(".card")).to_have_count(1)
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_enabled()
