"""Races: several pilots on the same map, live and annotated."""

import httpx
from playwright.sync_api import Page, expect

from drone_env.episodes.record import parse_record
from tests.api.serving import Server
from tests.browser.flights import flown, frames
from tests.browser.stage import fly, pictures, points

SEED = 20
"""A map on which chance, too, delivers, after twelve steps."""
NAMES = {"pathqnet": "PathQNet", "greedy": "Greedy", "optimal": "Optimal", "random": "Random"}


def test_four_race_as_their_agents_fly_and_each_is_annotated_beside_the_ghost_of_a_best_flight(
    page: Page, server: Server
) -> None:
    flights = {agent: frames(server.url, flown("easy", SEED, agent)) for agent in NAMES}
    page.goto(f"/?task=easy&seed={SEED}&pilots={','.join(NAMES)}")
    expect(page.locator("#maps figure")).to_have_count(4)
    fly(page)
    expect(page.get_by_role("button", name="Fly again")).to_be_visible()
    optimum = flights["optimal"][-1]["score"]
    moves = page.get_by_role("list", name="Moves")
    for row, (agent, name) in zip(page.locator("#standings tbody tr").all(), NAMES.items(), strict=True):
        last = flights[agent][-1]
        expect(row.get_by_role("rowheader")).to_have_text(name)
        expect(row.get_by_role("cell")).to_have_text(
            [str(last["step"]), f"{last['deliveries_done']}/1", points(last["score"]), points(optimum - last["score"])]
        )
        known = httpx.get(f"{server.url}/episodes", params={"task": "easy", "agent": agent}).json()["episodes"]
        answer = httpx.get(f"{server.url}/episodes/{next(one['id'] for one in known if one['seed'] == SEED)}")
        assert parse_record(answer.content, "it").actions == flown("easy", SEED, agent).actions
        annotation = httpx.post(f"{server.url}/annotate", json=answer.json()).json()
        row.get_by_role("button", name=name).click()
        expect(moves.get_by_role("button")).to_have_count(len(annotation["moves"]))
        for label, count in annotation["counts"].items():
            expect(moves.locator(f"button[data-label={label}]")).to_have_count(count)
    assert flights["random"][-1]["score"] < optimum
    expect(page.locator("#race-note")).to_have_text(
        f"PathQNet, Greedy, and Optimal tie with {points(optimum)}: all parcels delivered. "
        f"The optimum of this map is {points(optimum)}."
    )
    ghost = page.get_by_role("checkbox", name="Best flight")
    expect(ghost).to_be_checked()
    with_ghosts = pictures(page)
    page.keyboard.press("g")
    expect(ghost).not_to_be_checked()
    cities_and_flights = zip(with_ghosts, pictures(page), strict=True)
    assert [one == other for one, other in cities_and_flights] == [True, False] * 4


def test_who_races_is_chosen_with_two_to_four_boxes(page: Page) -> None:
    page.goto("/?task=easy&seed=5&pilot=greedy")
    page.get_by_role("link", name="Race", exact=True).click()
    expect(page.locator("#maps figure")).to_have_count(4)
    expect(page.get_by_role("checkbox", name="You")).to_be_disabled()
    page.get_by_role("checkbox", name="Tournet", exact=True).uncheck()
    expect(page.locator("#maps figure")).to_have_count(3)
    page.get_by_role("checkbox", name="You").check()
    expect(page.locator("#maps figure")).to_have_count(4)
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value("5")
    for name, left in (("You", 3), ("Greedy", 2)):
        page.get_by_role("checkbox", name=name).uncheck()
        expect(page.locator("#maps figure")).to_have_count(left)
    expect(page.get_by_role("checkbox", name="Optimal")).to_be_disabled()


def test_over_skyline_tournet_races_greedy_and_the_optimum_unless_others_are_named(page: Page, server: Server) -> None:
    page.goto("/?task=skyline_easy&seed=7")
    expect(page.get_by_role("radio", name="Tournet", exact=True)).to_be_checked()
    page.get_by_role("link", name="Race", exact=True).click()
    racers = {"tournet": "Tournet", "greedy": "Greedy", "optimal": "Optimal", "tournet-search": "Tournet search"}
    standings = page.locator("#standings tbody").get_by_role("rowheader")
    expect(standings).to_have_text(list(racers.values()))
    expect(page.get_by_role("checkbox", name="PathQNet")).to_be_disabled()
    fly(page)
    expect(page.get_by_role("button", name="Fly again")).to_be_visible()
    for row, agent in zip(page.locator("#standings tbody tr").all(), racers, strict=True):
        score = flown("skyline_easy", 7, agent).score
        expect(row.get_by_role("cell").nth(2)).to_have_text(points(score))
