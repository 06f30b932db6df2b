"""Reasons to come back: the map of the day, the visitor's name and best score; and the values of a cell."""

import re
from collections.abc import Callable
from datetime import datetime, timedelta, timezone

import pytest
from playwright.sync_api import Page, Route, expect

from drone_env.core.tasks import get_task
from drone_env.flights.provenance import Provenance
from drone_env.models import DIRECTIONS
from drone_env.planning.optimal import solve
from drone_env.server.daily import map_of_the_day
from tests.api.serving import Server
from tests.browser.flights import fill, flown, get
from tests.browser.shown import expect_step, notes, pictures, points
from tests.browser.stage import ended, enter, keys, over, press, until
from tests.browser.tabs import Tabs
from tests.browser.test_several import KEYS


def figures(page: Page) -> dict[str, str]:
    rows = page.locator(".by-hand div").all_inner_texts()
    return dict(row.split("\n") for row in rows)


def test_the_map_of_the_day_is_flown_under_a_name_and_the_page_remembers_the_best_score(
    page: Page, server: Server, shared: Tabs
) -> None:
    task, seed = map_of_the_day(datetime.now(timezone.utc))
    best = solve(task, seed)
    field, entry = page.locator("#name"), page.locator(".best-today li")
    # Junk in the storage is no name and no result.
    page.evaluate("localStorage['drone-env-name'] = '<b>'; localStorage['drone-env-best'] = '[[1], 7, null]'")
    late: list[Route] = []
    page.route("**/today", lambda route, _: route.continue_() if late else late.append(route))
    over(page, seed, f"/?task={task}&seed={seed}&pilot=human")
    expect_step(page, 0, get_task(task).max_steps)
    until(page, lambda: bool(late))
    before = late[0].fetch()
    refused = page.get_by_role("alert").filter(has_text="without spaces")
    for name, shown in (("not a name", 1), (" undo ", 0)):
        enter(field, name)
        expect(refused).to_have_count(shown)
    page.locator("#step-counter").click()
    keys(page, *(KEYS[DIRECTIONS[action]] for action in best.actions))
    ended(page)
    expect(entry).to_have_text([f"undo {points(best.score)}, {best.steps} steps"])
    # An answer from before the flight that arrives only now changes nothing.
    with page.expect_response("**/today"):
        late[0].fulfill(response=before)
    page.unroute("**/today")
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    score = points(best.score)
    shown = {"You": score, "Your best": score, "Possible": score, "Best today": score}
    until(page, lambda: figures(page) == shown)
    # A text to share has the last seven days and no move.
    now = datetime.now(timezone.utc)
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    press(page, "Copy result")
    expect(page.locator("#toasts")).to_contain_text("Copied, without your moves.")
    assert page.evaluate("navigator.clipboard.readText()").split("\n") == [
        f"Drone Delivery, {now.day} {now:%B}: 100 % of the optimum, 1 day in a row",
        "······█",
        f"{server.url}/?task={task}&seed={seed}&pilot=human",
    ]
    (stored,) = get(server, "episodes", task=task, seed=seed)["episodes"]
    assert stored["agent"] == "human (undo)"
    # The name is not mistaken for help, and a stored flight shows it to others.
    page.evaluate("delete localStorage['drone-env-flown']")
    entry.get_by_role("link", name="undo", exact=True).click()
    expect(page).to_have_url(f"{server.url}/?episode={stored['id']}")
    expect(page.locator("#results-title")).to_have_text("undo: All parcels delivered.")


@pytest.mark.long
def test_the_greeting_shows_the_days_in_a_row_and_a_ghost_of_yesterday(
    page: Page, beside: Callable[..., Page], server: Server
) -> None:
    today = datetime.now(timezone.utc)
    days = [map_of_the_day(today - timedelta(ago)) for ago in range(6)]
    (task, seed) = days[1]
    shares = {1: 1.0, 2: 0.5, 3: 0.99, 5: 0.0}
    best = [[f"{days[ago][0]} {days[ago][1]}", share, 1.0] for ago, share in shares.items()]
    page.evaluate("best => (localStorage['drone-env-best'] = JSON.stringify(best))", best)
    (ghost,) = fill(server.data, [flown(task, seed, "greedy", label=Provenance(pilot="human", person="Eve"))])
    other = beside("/")
    weights = next(one["score_weights"] for one in get(server, "tasks")["tasks"] if one["id"] == "skyline_medium")
    expect(other.locator(".meaning strong")).to_have_text([f"{part:g}" for part in weights.values()])
    own = other.locator("#own-days")
    # Today's map is not flown yet, which ends no row.
    expect(own).to_contain_text("·▁·▇▄█·3 days in a row")
    other.get_by_role("link", name="Fly against the best of yesterday, ").click()
    expect_step(other, 0, get_task(task).max_steps)
    expect(other.locator(".plan-head")).to_contain_text("Eve, You")
    other.keyboard.press(" ")
    expect(other.locator("#step-counter")).to_contain_text("Step 1 of")
    expect(other).to_have_url(re.compile(rf"task={task}&seed={seed}&pilot=human&ghost={ghost}&of=human&actions=W$"))
    # A flight beside a ghost is listed like any other.
    expect(other.locator("#unlisted")).to_be_hidden()
    other.reload()
    expect(other.locator("#step-counter")).to_contain_text("Step 1 of")
    press(other, "Reset")
    press(other, "Start over")
    expect_step(other, 0, get_task(task).max_steps)
    expect(other.locator(".plan-head")).to_contain_text("Eve, You")


def test_a_cell_shows_what_it_costs_the_value_of_each_action_and_a_scale(page: Page, server: Server) -> None:
    over(page, 152, "/?task=skyline_easy&seed=152&pilot=greedy")
    expect_step(page, 0, 60)
    pictures(page)  # drawn
    words = {line for lines in notes(page) for line in lines}
    assert {"Pad: costs 1 unit, each wait charges 4", "Obstacle: closed", "Road: costs 1 unit"} <= words
    # Without any layer, the moves from here have their values.
    expect(page.locator("#q-values tr.best")).not_to_have_count(0)
    values = server.client.post("/values", json={"task": "skyline_easy", "seed": 152}).json()
    x, y = values["position"]
    rows = [value for row in values["cells"]["values"] for value in row if value is not None]
    page.keyboard.press("v")
    try:
        expect(page.locator(".scale")).to_have_text(f"best cell {points(max(rows))}worst {points(min(rows))}")
        signs, best = "↑↓←→•", values["value"]
        q_values = zip(signs, values["cells"]["q_values"][y][x], strict=True)
        lost = [
            (sign, value, f", loses {points(best - value)}" if best - value > 0.0005 else "")
            for sign, value in q_values
        ]
        wanted = [f"{sign} {points(value)}{loses}" for sign, value, loses in lost]
        until(page, lambda: wanted in [lines[1:] for lines in notes(page)])
    finally:
        page.keyboard.press("v")
