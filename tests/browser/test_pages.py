"""Learn and API: the tutorial, the specifications, the snippets and the logs, true and as the server states them."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from playwright.sync_api import Page, Route, expect

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.models import DIRECTIONS
from drone_env.planning.optimal import solve
from drone_env.results.analysis import analyse_flight
from tests.api.serving import Server
from tests.browser.conftest import TRAINING
from tests.browser.flights import flown, get
from tests.browser.shown import expect_flying, expect_step, fixed, points
from tests.browser.stage import ended, expect_task, fly, keys, moves, press, show, task, until, view
from tests.browser.test_several import KEYS

ALONE = ("easy", 18)
BLUNDER = ("skyline_easy", 88)
PADS = ("skyline_easy", 84)


def test_what_the_lessons_say_of_their_maps_is_true(page: Page) -> None:
    cards = page.locator(".lesson p")
    expect(cards).to_have_count(3)
    alone, blunder, pads = cards.all_inner_texts()
    assert f"takes {len(solve(*ALONE).actions)} moves" in alone
    lost = analyse_flight(flown(*BLUNDER, "greedy"))
    worst = max(lost.moves, key=lambda move: move.regret)
    assert (worst.label, worst.regret, worst.best_actions) == ("blunder", lost.regret, (Action.WAIT,))
    assert f"optimum of this map is {points(lost.optimum)}; Greedy scores {points(lost.score)}," in blunder
    assert f"holds {get_task(PADS[0]).battery_capacity} units" in pads
    without = replace(get_task(PADS[0]), charge_rate=0)
    assert Episode(without, seed=PADS[1]).fly(solve(without, PADS[1]).actions).deliveries_done == 2
    assert "more than two of the three parcels" in pads


def test_the_lessons_are_flown_one_after_the_other_and_learn_remembers_them(page: Page) -> None:
    bar = page.get_by_role("region", name="Lesson")
    reached = bar.locator("[data-reached=true]")
    page.get_by_role("link", name="Begin: Fly yourself").click()
    expect(page).to_have_url(re.compile(r"/\?task=easy&seed=18&pilot=human&lesson=1$"))
    expect_step(page, 0, 60)
    best = solve(*ALONE).actions
    page.keyboard.press(KEYS[DIRECTIONS[best[0]]])
    expect(reached).to_have_text(["Make a move"])
    keys(page, *(KEYS[DIRECTIONS[action]] for action in best[1:]))
    expect(reached).to_have_count(3)
    # The button of the next task would leave the lesson.
    expect(ended(page)).to_contain_text("All parcels delivered")
    expect(page.locator("#next")).to_be_hidden()
    # Another map is no part of the lesson.
    page.keyboard.press("n")
    expect(bar).to_be_hidden()
    page.go_back()
    bar.get_by_role("link", name="Next lesson").click()
    expect(page).to_have_url(re.compile(r"/\?task=skyline_easy&seed=88&pilot=greedy&lesson=2$"))
    expect(reached).to_have_count(0)
    fly(page)
    expect(reached).to_have_text(["Let Greedy finish"])
    expect(page.locator("#again")).to_be_visible()
    page.locator("#worst").click()
    expect(reached).to_have_count(2)
    page.locator("#again").click()
    expect(page).to_have_url(re.compile("&lesson=2$"))
    expect_flying(page, "Greedy", "You")
    keys(page, " ", " ", *["ArrowLeft"] * 3)
    expect(reached).to_have_count(3)

    view(page, "Learn")
    page.reload()
    expect(page.locator(".lesson [data-reached=true]")).to_have_count(6)


def test_the_tasks_are_above_the_map_one_click_away(page: Page) -> None:
    show(page, "/?task=easy&seed=7&pilot=greedy")
    expect_task(page, "Easy")
    bar = page.get_by_role("navigation", name="Tasks").get_by_role("button")
    expect(bar).to_have_text(["Easy", "Medium", "Hard", "Skyline", "Rush", "City", "Map of the day", "Specifications"])
    for name, first, steps in (("Skyline", "Skyline Easy", 60), ("City", "City Small", 160), ("Medium", "Medium", 100)):
        task(page, name).click()
        expect_task(page, first)
        expect_step(page, 0, steps)
        expect_flying(page, "Greedy")
    task(page, "Map of the day").click()
    expect_task(page, "Map of the day")
    expect_flying(page, "You")
    # A flight that has begun is given up after a question only, also while its first move is on the way.
    moved: list[Route] = []
    page.route("**/flights/change", lambda route, _: moved.append(route))
    page.keyboard.press(" ")
    until(page, lambda: bool(moved))
    task(page, "Easy").click()
    expect(page.get_by_role("dialog")).to_contain_text("your flight at step 1?")
    press(page, "Keep flying")
    expect_task(page, "Map of the day")
    moved[0].continue_()
    page.unroute("**/flights/change")
    expect(moves(page)).to_have_count(1)
    page.keyboard.press("Escape")


@pytest.mark.feature("D4")
def test_the_tasks_of_a_family_are_shown_side_by_side_as_the_server_states_them(page: Page, server: Server) -> None:
    tasks = get(server, "tasks")["tasks"]
    for family, flight, most in (("Standard", "easy", 60), ("Skyline", "skyline_hard", 160)):
        table = page.get_by_role("table", name=f"Technical specifications of the {family} tasks")
        expect(table).to_be_visible()  # in Learn
        show(page, f"/?task={flight}&seed=7&pilot=greedy")
        expect_step(page, 0, most)
        task(page, "Specifications").click()
        expect(table).to_be_visible()
        rows = table.evaluate("table => [...table.rows].map(row => [...row.cells].map(cell => cell.textContent))")
        levels = [one for one in tasks if one["family"] == family.lower()]
        assert ["Id", *(one["id"] for one in levels)] in rows
        assert ["Battery", *(f"{one['battery_capacity']} units" for one in levels)] in rows
        for event, row in {"delivery": "Delivery", "wait": "Wait", "battery_dead": "Battery empty"}.items():
            pays = (one["rewards"]["tiered"][event] for one in levels)
            assert [row, *(" / ".join(map(fixed, pay)) for pay in pays)] in rows
        # It covers no key of the flight.
        page.keyboard.press("ArrowRight")
        expect_step(page, 1, most)
        page.locator("#specifications").get_by_role("button", name="Close").click()
        view(page, "Learn")


def test_the_legend_shows_what_each_kind_of_cell_does(page: Page, server: Server) -> None:
    legend = page.get_by_role("region", name="Legend")
    kinds = [kind for kind in get(server, "kinds")["kinds"] if kind["name"] != "unknown"]
    expect(legend.locator("dd")).to_have_text([kind["effect"] for kind in kinds])
    # Figures of the map, not emoji, which need a font; and kinds have no rewards.
    assert legend.inner_text().isascii()
    assert "reward" not in legend.inner_text().lower()
    empty = """all => all.map(one => one.getContext("2d").getImageData(0, 0, one.width, one.height).data)
        .filter(pixels => !pixels.some(Boolean)).length"""
    assert legend.locator("canvas").evaluate_all(empty) == 1, "only a road has no figure"


@pytest.mark.long
def test_the_reference_of_all_calls_has_the_colours_of_the_page(beside: Callable[..., Page]) -> None:
    reference = beside("/docs")
    expect(reference.locator("#operations-flight-reset")).to_be_visible()
    expect(reference.locator("html")).to_have_css("background-color", "rgb(28, 32, 34)")


@pytest.mark.feature("D1")
def test_the_logs_show_requests_and_training_as_they_come(page: Page, server: Server, data: Path) -> None:
    view(page, "API")
    requests, training = (page.get_by_role("log", name=name) for name in ("Requests", "Training"))
    expect(requests).to_contain_text("GET /tasks 200")
    server.client.get("/grade/nowhere")
    expect(requests.get_by_text("/grade/nowhere")).to_have_count(1)
    for line in TRAINING:
        expect(training.get_by_text(line, exact=True)).to_be_visible()
    with (data / "train.log").open("a", encoding="utf-8") as file:
        file.write("episode 4 reward 9.99\n")
    expect(training.get_by_text("episode 4 reward 9.99", exact=True)).to_be_visible()
