"""Several pilots on one map: on one board or on boards of their own, ranked, each in its colour."""

import re

from playwright.sync_api import Locator, Page, Route, expect

from drone_env.results.record import parse_record
from tests.api.serving import Server
from tests.browser.flights import flown, frames, possible, posted
from tests.browser.shown import painted, pictures, points
from tests.browser.stage import along, fly, over, pilot, step

SEED = 20
"""A map on which chance, too, delivers, after twelve steps."""
NAMES = {"random": "Random", "pathqnet": "PathQNet", "greedy": "Greedy", "optimal": "Optimal"}


def standings(page: Page) -> Locator:
    return page.get_by_role("table", name="Standings").locator("tbody tr")


def ranked(values: dict[str, float]) -> list[str]:
    """The names of pilots, the best first; of equals the one that is named first."""
    return [NAMES[agent] for agent in sorted(values, key=values.__getitem__, reverse=True)]


def test_four_are_ranked_while_they_fly_as_their_agents_do_and_each_is_annotated(page: Page, server: Server) -> None:
    records = {agent: flown("easy", SEED, agent) for agent in NAMES}
    flights = {agent: frames(server, record) for agent, record in records.items()}
    values = {agent: possible(server, record) for agent, record in records.items()}
    over(page, SEED, f"/?task=easy&seed={SEED}&pilots={','.join(NAMES)}")
    names = standings(page).get_by_role("rowheader")
    expect(names).to_have_text(list(NAMES.values()))
    for at in (1, 2, 3):
        step(page)
        now = {agent: value[at] for agent, value in values.items()}
        expect(names).to_have_text(ranked(now))
        chance = standings(page).filter(has_text="Random").get_by_role("cell")
        expect(chance).to_have_text(
            [str(at), "0/1", points(now["random"]), points(values["random"][0] - now["random"])]
        )
    assert ranked(now)[0] != "Random"
    fly(page, "Go on")
    optimum = flights["optimal"][-1]["score"]
    assert flights["random"][-1]["score"] < optimum
    expect(page.locator("#standings-note")).to_have_text(f"A tie with {points(optimum)}.")
    expect(names).to_have_text(ranked({agent: flight[-1]["score"] for agent, flight in flights.items()}))
    moves = page.get_by_role("list", name="Moves").get_by_role("button")
    for number, (agent, name) in enumerate(NAMES.items(), 1):
        last, row = flights[agent][-1], standings(page).filter(has_text=name)
        expect(row.get_by_role("cell")).to_have_text(
            [str(last["step"]), "1/1", points(last["score"]), points(optimum - last["score"])]
        )
        known = server.client.get("/episodes", params={"task": "easy", "agent": agent}).json()["episodes"]
        stored = server.client.get(f"/episodes/{next(one['id'] for one in known if one['seed'] == SEED)}")
        assert parse_record(stored.content, "it").actions == records[agent].actions
        # By mouse, and by the keys of their numbers.
        if number % 2:
            row.get_by_role("button", name=name).click()
        else:
            page.keyboard.press(str(number))
        expect(standings(page).and_(page.locator(".selected"))).to_contain_text(name)
        expect(moves).to_have_count(last["step"])
        for label, count in posted(server, "annotate", records[agent])["counts"].items():
            expect(moves.and_(page.locator(f"[data-label={label}]"))).to_have_count(count)
    page.keyboard.press("Home")
    expect(names).to_have_text(list(NAMES.values()))


def test_boards_of_their_own_the_ghost_of_a_best_flight_and_a_colour_that_is_the_pilots(
    page: Page, server: Server
) -> None:
    known = server.client.get("/pilots").json()["pilots"]
    colours = {one["id"]: f"--pilot-{one['colour']}" for one in known}
    over(page, SEED, f"/?task=easy&seed={SEED}&pilots=greedy,random")
    boards = page.get_by_role("img", name="City map")
    expect(standings(page)).to_have_count(2)
    assert painted(boards, *colours.values()) == [colours["greedy"]], "brackets around the target of who is looked at"
    page.keyboard.press("2")
    assert painted(boards, *colours.values()) == [colours["random"]]
    apart = page.get_by_role("checkbox", name="A board each")
    apart.check()
    cards = page.get_by_role("figure")
    expect(cards).to_have_count(2)
    assert painted(boards.nth(0), *colours.values()) == [colours["greedy"]]
    assert painted(boards.nth(1), *colours.values()) == [colours["random"]]
    fly(page)
    expect(page.locator("#standings-note")).to_contain_text("Greedy wins with")
    for card, agent, name in zip(cards.all(), ("greedy", "random"), ("Greedy", "Random"), strict=True):
        last = flown("easy", SEED, agent)
        head = card.get_by_role("button", name=name)
        expect(head).to_contain_text(f"{points(last.score)} · All parcels delivered")
        head.click()
        expect(head).to_have_attribute("aria-pressed", "true")
        expect(page.locator("#score")).to_have_text(points(last.score))
    ghost = page.get_by_role("checkbox", name="A best flight")
    expect(ghost).to_be_checked()
    with_ghosts = pictures(page)
    page.keyboard.press("g")
    expect(ghost).not_to_be_checked()
    kept = [one == other for one, other in zip(with_ghosts, pictures(page), strict=True)]
    assert kept == [True, True, False] * 2, "city and cells stay, the flights change"
    apart.uncheck()
    expect(cards).to_have_count(0)
    expect(boards).to_have_count(1)
    ghost.check()
    # Alone, too, and named in another order, a pilot keeps its colour.
    pilot(page, "Random").click()
    expect(page.locator("#standings")).to_be_hidden()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    assert painted(boards, *colours.values()) == [colours["random"]]
    expect(page.locator(".pilot", has_text="Random")).to_have_attribute("style", f"--lane: var({colours['random']});")


def test_who_flies_is_chosen_by_name_or_box_and_the_server_says_how_many(page: Page) -> None:
    def allow_two(route: Route) -> None:
        route.fulfill(json={**route.fetch().json(), "most": 2})

    page.route("**/pilots", allow_two)
    page.goto("/?task=easy&seed=5&pilot=greedy")
    expect(page.get_by_role("group", name="Pilots, up to 2")).to_be_visible()
    page.unroute("**/pilots")
    expect(along(page, "Greedy")).to_be_checked()
    expect(along(page, "Greedy")).to_be_disabled()
    along(page, "Optimal").check()
    expect(standings(page).get_by_role("rowheader")).to_have_text(["Greedy", "Optimal"])
    expect(page).to_have_url(re.compile("pilots=greedy,optimal"))
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value("5")
    expect(along(page, "You")).to_be_disabled()
    along(page, "Greedy").uncheck()
    expect(page.locator("#standings")).to_be_hidden()
    expect(along(page, "You")).to_be_enabled()
    expect(along(page, "Optimal")).to_be_disabled()
    pilot(page, "Random").click()
    expect(pilot(page, "Random")).to_have_attribute("aria-pressed", "true")
    expect(along(page, "Optimal")).not_to_be_checked()
    expect(page).to_have_url(re.compile("pilot=random"))


def test_over_skyline_tournet_flies_unless_another_is_named_and_who_cannot_says_so(page: Page, server: Server) -> None:
    page.goto("/?task=skyline_easy&seed=7")
    expect(pilot(page, "Tournet")).to_have_attribute("aria-pressed", "true")
    expect(pilot(page, "PathQNet")).to_be_disabled()
    expect(along(page, "PathQNet")).to_be_disabled()
    expect(page.locator(".pilot", has_text="PathQNet")).to_contain_text("has no network here")
    racers = {"tournet": "Tournet", "greedy": "Greedy", "tournet-search": "Tournet search", "optimal": "Optimal"}
    for name in list(racers.values())[1:]:
        along(page, name).check()
        expect(standings(page).filter(has=page.get_by_role("button", name=name, exact=True))).to_have_count(1)
    fly(page)
    expect(page.get_by_role("button", name="Play", exact=True)).to_be_visible()
    for agent, name in racers.items():
        row = standings(page).filter(has=page.get_by_role("button", name=name, exact=True))
        expect(row.get_by_role("cell").nth(2)).to_have_text(points(flown("skyline_easy", 7, agent).score))
    # Who cannot fly another task gives way to one that can.
    pilot(page, "Tournet").click()
    page.get_by_role("radio", name="Easy", exact=True).check()
    pilot(page, "PathQNet").click()
    expect(page).to_have_url(re.compile("task=easy&seed=[0-9]+&pilot=pathqnet"))
    page.get_by_role("radio", name="Skyline Easy").check()
    expect(page.locator("#toasts")).to_contain_text("PathQNet cannot fly Skyline Easy.")
    expect(pilot(page, "Tournet")).to_have_attribute("aria-pressed", "true")


def test_a_person_who_has_flown_nothing_yet_can_still_win_all(page: Page) -> None:
    over(page, SEED, f"/?task=easy&seed={SEED}&pilots=random,human")
    names = standings(page).get_by_role("rowheader")
    expect(names).to_have_text(["Random", "You"])
    expect(standings(page).filter(has_text="Random").get_by_role("cell").nth(3)).to_have_text("0.0")
    step(page)
    expect(names).to_have_text(["You", "Random"])
    expect(standings(page).filter(has_text="You").get_by_role("cell")).to_have_text(["0", "0/1", "\u2013", "\u2013"])
