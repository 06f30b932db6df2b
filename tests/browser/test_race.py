"""Races: several pilots on the same map, live and annotated."""

import httpx
from playwright.sync_api import Page, expect

from tests.api.serving import Server
from tests.browser.flights import flown, frames
from tests.browser.stage import fly, points

NAMES = {"pathqnet": "PathQNet", "greedy": "Greedy", "optimal": "Optimal", "random": "Random"}


def test_four_race_on_one_map_and_stand_as_their_agents_fly(page: Page, server: Server) -> None:
    flights = {agent: frames(server.url, flown("medium", 7, agent)) for agent in NAMES}
    page.goto(f"/?task=medium&seed=7&pilots={','.join(NAMES)}")
    expect(page.locator("#maps figure")).to_have_count(4)
    fly(page)
    rows = page.locator("#standings tbody tr")
    expect(page.get_by_role("button", name="Fly again")).to_be_visible(timeout=20_000)
    optimum = flights["optimal"][-1]["score"]
    for row, (agent, name) in zip(rows.all(), NAMES.items(), strict=True):
        last = flights[agent][-1]
        expect(row.get_by_role("rowheader")).to_have_text(name)
        expect(row.get_by_role("cell")).to_have_text(
            [str(last["step"]), f"{last['deliveries_done']}/3", points(last["score"]), points(optimum - last["score"])]
        )
    expect(page.locator("#race-note")).to_contain_text(f"The optimum of this map is {points(optimum)}")


def test_afterwards_each_flight_is_annotated_beside_the_ghost_of_a_best_one(page: Page, server: Server) -> None:
    page.goto("/?task=easy&seed=40&pilots=random,greedy")
    fly(page)
    episode = {}
    expect(page.get_by_role("button", name="Fly again")).to_be_visible(timeout=20_000)
    for agent in ("random", "greedy"):
        known = httpx.get(f"{server.url}/episodes", params={"task": "easy", "agent": agent}).json()["episodes"]
        episode[agent] = next(one for one in known if one["seed"] == 40)
        record = httpx.get(f"{server.url}/episodes/{episode[agent]['id']}").json()
        annotation = httpx.post(f"{server.url}/annotate", json=record).json()
        page.locator("#standings").get_by_role("button", name=NAMES[agent]).click()
        moves = page.get_by_role("list", name="Moves")
        expect(moves.get_by_role("button")).to_have_count(len(annotation["moves"]))
        for label, count in annotation["counts"].items():
            expect(moves.locator(f"button[data-label={label}]")).to_have_count(count)
    ghost = page.get_by_role("checkbox", name="Best flight")
    expect(ghost).to_be_checked()
    flight = page.locator("#maps figure").first.locator("canvas").last
    page.wait_for_timeout(200)
    with_ghost = flight.evaluate("canvas => canvas.toDataURL()")
    ghost.uncheck()
    page.wait_for_timeout(200)
    assert flight.evaluate("canvas => canvas.toDataURL()") != with_ghost


def test_who_races_is_chosen_with_two_to_four_boxes(page: Page) -> None:
    page.goto("/?task=easy&seed=5&pilot=greedy")
    page.get_by_role("link", name="Race", exact=True).click()
    expect(page.locator("#maps figure")).to_have_count(4)
    expect(page.get_by_role("checkbox", name="You")).to_be_disabled()
    page.get_by_role("checkbox", name="Random").uncheck()
    expect(page.locator("#maps figure")).to_have_count(3)
    page.get_by_role("checkbox", name="You").check()
    expect(page.locator("#maps figure")).to_have_count(4)
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value("5")
