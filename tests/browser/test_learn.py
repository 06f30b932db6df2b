"""Learn: the tutorial, whose texts are true of their maps, and the specifications, as the server tells them."""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect

from drone_env.core.actions import Action, Outcome
from drone_env.core.episode import Episode
from drone_env.core.tasks import get_task
from drone_env.planning.optimal import solve
from drone_env.results.analysis import analyse_flight
from drone_env.results.record import record_of
from tests.api.serving import Server
from tests.browser.flights import flown, frames
from tests.browser.shown import fixed, points
from tests.browser.stage import view

ALONE = ("easy", 18)
BLUNDER = ("skyline_easy", 88)
PADS = ("skyline_easy", 84)


def flight(task: str, seed: int, actions: list[Action]) -> Episode:
    """A flight by a person, as far as `actions` go."""
    episode = Episode(task, "tiered", seed)
    for action in actions:
        episode.step(action)
    return episode


def track(server: Server, flown: Episode, pilot: str = "human", by: str | None = None) -> dict[str, Any]:
    """What the page has of a flight: the server's frames, and at its end what each step lost."""
    start: list[dict[str, Any]] = [{"outcome": "flying", "step": 0}]
    shown = frames(server, record_of(flown, pilot)) if flown.steps else start
    if flown.ended:
        analysis = analyse_flight(record_of(flown, pilot))
        for frame, value in zip(shown, analysis.values, strict=True):
            frame["regret"] = analysis.optimum - value
    else:
        shown = [frame | {"regret": None} for frame in shown]
    return {"pilot": pilot, "by": by or pilot, "frames": shown, "done": flown.ended}


def stage(*tracks: dict[str, Any], cursor: int = 0, playing: bool = False) -> dict[str, Any]:
    """The stage with these flights, the first of them selected."""
    return {"track": tracks[0], "tracks": tracks, "clock": {"cursor": cursor, "playing": playing}}


def goals(page: Page, lesson: int, stage: dict[str, Any]) -> list[int]:
    """The goals of a lesson, from 1, that a stage fulfils."""
    return page.evaluate(
        """async ([lesson, stage]) => {
            const { LESSONS } = await import("/static/js/lessons.js");
            return LESSONS[lesson - 1].goals.flatMap(({ done }, i) => done(stage) ? [i + 1] : []);
        }""",
        [lesson, stage],
    )


def test_what_the_lessons_say_of_their_maps_is_true(page: Page) -> None:
    view(page, "Learn")
    cards = page.locator(".lesson p")
    expect(cards).to_have_count(3)
    alone, blunder, pads = cards.all_inner_texts()
    best = solve(*ALONE)
    assert f"takes {len(best.actions)} moves" in alone
    assert best.score == flight(*ALONE, list(best.actions)).score

    lost = analyse_flight(flown(*BLUNDER, "greedy"))
    worst = max(lost.moves, key=lambda move: move.regret)
    assert worst.label == "blunder"
    assert lost.regret == worst.regret
    assert worst.best_actions == (Action.WAIT,)
    assert f"optimum of this map is {points(lost.optimum)}; Greedy scores {points(lost.score)}," in blunder
    assert get_task(BLUNDER[0]).charge_rate > 0

    task = get_task(PADS[0])
    drain = {cell.name: units for cell, units in task.drain}
    assert f"holds {task.battery_capacity} units" in pads
    assert f"above a tree {drain['TREE']}, above a building {drain['BUILDING']}, and obstacles block" in pads
    assert [cell.name for cell in task.impassable] == ["OBSTACLE"]
    assert f"charges {task.charge_rate}." in pads
    without = Episode(replace(task, charge_rate=0), "tiered", PADS[1])
    for action in solve(without.task, PADS[1]).actions:
        without.step(action)
    assert (without.deliveries_done, task.deliveries) == (2, 3)
    assert "more than two of the three parcels" in pads


def test_goals_are_reached_by_the_flights_that_their_lessons_ask_for(page: Page, server: Server) -> None:
    best = list(solve(*ALONE).actions)
    for actions, reached in (([], []), (best[:1], [1]), ([Action.WAIT, *best], [1, 2]), (best, [1, 2, 3])):
        assert goals(page, 1, stage(track(server, flight(*ALONE, actions)))) == reached
    assert goals(page, 1, stage(track(server, flight(*ALONE, best), "optimal"))) == []

    record = flown(*BLUNDER, "greedy")
    hasty = [Action[name] for name in record.actions]
    greedy = track(server, flight(*BLUNDER, hasty), "greedy")
    step = next(move.step for move in analyse_flight(record).moves if move.regret)
    for cursor, playing, reached in (
        (len(hasty), False, [1]),
        (step, False, [1, 2]),
        (step - 1, False, [1, 2]),
        (step - 1, True, [1]),
        (step - 2, False, [1]),
    ):
        assert goals(page, 2, stage(greedy, cursor=cursor, playing=playing)) == reached
    assert goals(page, 2, stage(track(server, flight(*BLUNDER, hasty[:-1]), "greedy"), cursor=step - 1)) == []
    careful = flight(*BLUNDER, [*hasty[: step - 1], Action.WAIT, Action.WAIT, *[Action.LEFT] * 3])
    assert careful.outcome is Outcome.DELIVERED
    for by, reached in ((f"human from step {step - 1} of greedy", [1, 3]), ("human with undo", [1])):
        assert goals(page, 2, stage(greedy, track(server, careful, by=by))) == reached
    again = track(server, flight(*BLUNDER, hasty), by=f"human with values from step {step - 1} of greedy")
    assert goals(page, 2, stage(greedy, again)) == [1]

    best = list(solve(*PADS).actions)
    pause = best.index(Action.WAIT)
    slow = [*best[:pause], *[Action.WAIT] * 20, *best[pause:]]
    for actions, reached in ((best[:pause], []), (best[: pause + 1], [1]), (slow, [1, 2]), (best, [1, 2, 3])):
        assert goals(page, 3, stage(track(server, flight(*PADS, actions)))) == reached
    assert goals(page, 3, stage(track(server, flight(*PADS, [Action.WAIT] * 11)))) == []


def outstanding(page: Page) -> list[str]:
    """The buttons that stand out as the way on."""
    return page.locator(".fly .primary:visible").evaluate_all(
        """buttons => {
            const accent = document.createElement("i");
            accent.style.background = "var(--accent)";
            document.body.append(accent);
            const colour = getComputedStyle(accent).backgroundColor;
            accent.remove();
            return buttons.filter(one => getComputedStyle(one).backgroundColor === colour).map(one => one.innerText);
        }"""
    )


def test_two_lessons_are_flown_one_after_the_other_and_learn_remembers_them(page: Page) -> None:
    view(page, "Learn")
    page.get_by_role("link", name="Begin: Fly yourself").click()
    expect(page).to_have_url(re.compile(r"/\?task=easy&seed=18&pilot=human&lesson=1$"))
    bar = page.get_by_role("region", name="Lesson")
    reached = bar.locator("[data-reached=yes]")
    expect(bar).to_contain_text("Lesson 1: Fly yourself")
    expect(bar.get_by_role("link")).to_have_text(["Back to Learn"])
    expect(page.locator("#step-counter")).to_have_text(re.compile("Step 0 "))
    page.keyboard.press("ArrowRight")
    expect(reached).to_have_text(["Reached: Make a move"])
    for key in ("ArrowRight", *["ArrowDown"] * 6):
        page.keyboard.press(key)
    expect(reached).to_have_count(3)
    expect(page.locator(".strip")).to_be_visible()
    assert outstanding(page) == ["Next lesson"]
    page.keyboard.press("n")
    expect(bar).to_be_hidden()
    page.go_back()

    bar.get_by_role("link", name="Next lesson").click()
    expect(page).to_have_url(re.compile(r"/\?task=skyline_easy&seed=88&pilot=greedy&lesson=2$"))
    expect(bar).to_contain_text("Lesson 2: See what a move loses")
    expect(reached).to_have_count(0)
    page.get_by_role("combobox", name="Speed").select_option("60")
    page.get_by_role("button", name="Start", exact=True).click()
    expect(reached).to_have_text(["Reached: Let Greedy fly to its end"])
    page.locator("#worst").click()
    expect(reached).to_have_count(2)
    page.locator("#try-worst").click()
    expect(page.get_by_role("group", name="Fly")).to_be_visible()
    for key in (*["Space"] * 2, *["ArrowLeft"] * 3):
        page.keyboard.press(key)
    expect(reached).to_have_count(3)

    bar.get_by_role("link", name="Back to Learn").click()
    page.reload()
    for name in ("Fly again: Fly yourself", "Fly again: See what a move loses", "Begin: Plan the battery"):
        expect(page.get_by_role("link", name=name)).to_be_visible()
    expect(page.locator(".lesson [data-reached=yes]")).to_have_count(6)
    expect(page.locator(".lesson .primary")).to_have_text("Begin")


def test_help_has_the_keys_and_leads_to_learn(page: Page) -> None:
    page.get_by_role("button", name="Keys and help").click()
    dialog = page.get_by_role("dialog", name="Help")
    expect(dialog.locator("kbd").filter(has_text="Space")).to_be_visible()
    dialog.get_by_role("link", name="Learn").click()
    expect(dialog).to_be_hidden()
    expect(page.get_by_role("heading", name="Learn", exact=True, level=2)).to_be_visible()


def table(page: Page, name: str) -> dict[str, list[str]]:
    """The cells of each row, by the row's heading."""
    rows = page.get_by_role("table", name=name).evaluate(
        "table => [...table.rows].map(row => [...row.cells].map(cell => cell.textContent))"
    )
    found: dict[str, list[str]] = {}
    profile = ""
    for name, *cells in rows:
        if not cells:
            paid = re.match(r"Rewards by event \((\w+)\)", name)
            profile = f", {paid[1]}" if paid else ""
        found[name + profile] = cells
    return found


@pytest.mark.feature("D4")
def test_the_tasks_stand_side_by_side_as_the_server_tells_them(page: Page, server: Server) -> None:
    tasks = server.client.get("/tasks").json()["tasks"]
    view(page, "Learn")
    for family, count in (("Standard", 3), ("City", 2), ("Skyline", 3)):
        page.get_by_role("radio", name=family, exact=True).check()
        shown = table(page, f"Technical specifications of the {family} tasks")
        levels = [task for task in tasks if task["family"] == family.lower()]
        assert len(levels) == count
        assert shown["Id"] == [task["id"] for task in levels]
        assert shown["Grid"] == [f"{task['width']} × {task['height']}" for task in levels]
        numbers = {
            "Parcels": "deliveries",
            "Buildings": "buildings",
            "Obstacles": "obstacles",
            "Steps at most": "max_steps",
        }
        for row, name in numbers.items():
            assert shown[row] == [str(task[name]) for task in levels]
        events = {"delivery": "Delivery", "tree": "Tree", "wait": "Wait", "battery_dead": "Battery empty"}
        for event, named in events.items():
            for profile in ("tiered", "composite"):
                pays = [" / ".join(f"{pay:.2f}" for pay in task["rewards"][profile][event]) for task in levels]
                assert shown[f"{named}, {profile}"] == pays
        assert shown["Battery"] == [f"{task['battery_capacity']} units" for task in levels]
        if family == "Standard":
            assert shown["Grid"] == ["10 × 10", "14 × 14", "18 × 18"]
            assert shown["Parcels"] == ["1", "3", "5"]
    assert "Charging pads" in shown


def test_all_reward_profiles_and_kinds_of_cells_are_told_as_the_server_does(page: Page, server: Server) -> None:
    view(page, "Learn")
    profiles = server.client.get("/tasks").json()["reward_profiles"]
    told = page.get_by_role("region", name="Reward profiles")
    expect(told.locator("dt")).to_have_text([profile["id"] for profile in profiles])
    for profile in profiles:
        entry = told.locator("dl > div").filter(has=page.get_by_text(profile["id"], exact=True))
        expect(entry).to_contain_text(profile["summary"])
        for number in (profile["shaping"], profile["shaping_gamma"], *(profile["clamp"] or ())):
            if number:
                expect(entry.locator("dd").last).to_contain_text(fixed(number))
        assert entry.locator("dd").last.inner_text().endswith("the score at the end") == profile["pays_score"]
    kinds = server.client.get("/kinds").json()["kinds"]
    legend = page.get_by_role("region", name="Legend")
    parcels = {"delivery": "Parcel", "delivered": "Delivered parcel"}
    names = [parcels.get(kind["name"], kind["name"].title()) for kind in kinds]
    expect(legend.locator("dt")).to_have_text([kind["emoji"] + name for kind, name in zip(kinds, names, strict=True)])
    expect(legend.locator("dd")).to_have_text([kind["effect"] for kind in kinds])


def test_a_task_of_a_plugin_stands_under_its_own_family(beside: Callable[[str], Page]) -> None:
    def tasks(route: Route) -> None:
        answer = route.fetch()
        known = answer.json()
        known["tasks"].append(known["tasks"][0] | {"id": "hop", "short_name": "parcel_hop", "family": "parcel"})
        route.fulfill(response=answer, json=known)

    page = beside("")
    page.route("**/tasks", tasks)
    page.goto("/?view=learn")
    page.get_by_role("radio", name="Parcel", exact=True).check()
    assert table(page, "Technical specifications of the Parcel tasks")["Id"] == ["hop"]
