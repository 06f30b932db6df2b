"""Flights that have ended: Mission Results, stored flights by their link, and flights in files."""

import json
import re
from decimal import Decimal

import pytest
from playwright.sync_api import Page, Route, expect

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rules import LOWEST
from drone_env.flights.provenance import Parent, Provenance
from drone_env.flights.record import record_of
from tests.api.serving import Server
from tests.browser.flights import flown, frames, get, posted
from tests.browser.shown import (
    at,
    box,
    expect_flying,
    expect_frame,
    expect_step,
    fixed,
    lost,
    measured,
    painted,
    percent,
    points,
)
from tests.browser.stage import (
    FASTEST,
    at_its_end,
    at_speed,
    choices,
    ended,
    expect_task,
    fly,
    map_number,
    moves,
    open_file,
    over,
    pilot,
    press,
    show,
    slider,
    view,
)
from tests.browser.tabs import Tabs


def expect_efficiency(page: Page, done: float, left: float) -> None:
    """The card shows three shares with their weights, and their sum."""
    efficiency = page.locator("#efficiency-parts")
    total = fixed(75 * done + 25 * left, 1)
    expect(efficiency.get_by_role("heading")).to_have_text(f"Efficiency {total} of 100 (not the score)")
    parts = (("Parcels delivered", done, 75), ("Battery left", left, 15), ("Steps left", left, 10))
    expect(efficiency.locator(".part")).to_have_text(
        [f"{name}{fixed(weight * share, 1)} of {weight}" for name, share, weight in parts]
    )


@pytest.mark.feature("D2", "D5")
def test_mission_results_show_score_efficiency_and_statistics_of_a_success_without_a_click(
    page: Page, server: Server
) -> None:
    # Chance delivers on this map, but late: it loses points.
    record = flown("easy", 82, "random")
    flight, annotation = frames(server, record), posted(server, "annotate", record)
    last = len(flight) - 1
    over(page, 82, "/?task=easy&seed=82&pilot=random")
    fly(page)
    card = ended(page)
    expect(card.get_by_role("heading", name="Mission Results")).to_be_visible()
    expect(card.get_by_role("heading", name="Random: All parcels delivered.")).to_be_visible()
    score, optimum = annotation["score"], annotation["optimum"]["score"]
    expect(card.locator(".hero")).to_have_text(f"{points(score)} / {points(optimum)} possible")
    # The parts of the score and what is lost add up to the optimum, also when rounded.
    parts = card.locator(".points-legend strong").all_inner_texts()
    assert len(parts) == 4
    assert sum(map(Decimal, parts)) == Decimal(points(optimum))
    assert parts[-1] == lost(optimum, score)
    expect(page.locator("#announcer")).to_have_text(f"Mission Results: All parcels delivered. Score {points(score)}.")
    expect_efficiency(page, 1, 1 - last / 60)  # both the battery and the steps are 60
    analysis = get(server, "analyse/easy")
    trend = analysis["success_trend"] * 100
    counted = card.locator("#analysis")
    expect(counted).to_contain_text(f"Average reward{fixed(analysis['average_reward'])}")
    expect(counted).to_contain_text(f"Success{percent(analysis['success_rate'])}")
    expect(counted).to_contain_text(f"Success trend{'+' * (trend >= 0)}{fixed(trend, 0)} points")
    shares = counted.get_by_role("group", name="Action distribution")
    for action, share in analysis["action_distribution"].items():
        expect(shares).to_contain_text(f"{action} {percent(share)}")
    assert card.evaluate("card => card.querySelector('details') === null"), "nothing is folded"
    move = max(annotation["moves"], key=lambda move: move["regret"])
    worst, possible = move["step"], annotation["moves"][move["step"]]["value"]
    best = " or ".join(move["best_actions"])
    seen = page.locator("#worst")
    expect(seen).to_have_text(
        f"Step {worst}, {flight[worst]['action']}, lost {points(move['regret'])}: {annotation['worst']['why']}"
    )
    seen.click()
    expect_frame(page, flight[worst - 1], 60)
    page.keyboard.press("ArrowRight")
    expect_frame(page, flight[worst], 60)
    live = page.locator(".live-points strong")
    expect(live).to_have_text(["0.0", points(possible), lost(optimum, possible)])
    told = f"Lost {points(move['regret'], 2)}. Best move: {best}. {points(possible)} still possible."
    expect(slider(page)).to_have_attribute("aria-valuetext", f"Step {worst}: {flight[worst]['message']} {told}")
    # The graph leads to each moment.
    page.keyboard.press("Home")
    slider(page).click(position=at(slider(page), worst / last))
    expect_frame(page, flight[worst], 60)
    # The keys of the page still work after a click on a move, which has the focus.
    moves(page).nth(worst - 1).click()
    expect(moves(page).nth(worst - 1)).to_have_attribute("aria-current", "step")
    expect_frame(page, flight[worst], 60)
    expect(page.locator("#move-detail")).to_have_text(f"{flight[worst]['message']} {told}")
    assert box(page, "#moves").height > 200, "most moves are seen without scrolling"
    page.keyboard.press("ArrowRight")
    expect_frame(page, flight[worst + 1], 60)

    def marked(selector: str) -> list[int]:
        """The steps at which the graph has marks."""
        paths = measured(page, f".timeline {selector}", "one.getAttribute('d')")
        return sorted(int(step) for step in re.findall(r"M(\d+)", "".join(paths)))

    wrong = [one["step"] for one in annotation["moves"] if one["label"] not in ("best", "good")]
    assert (marked("[data-label]"), marked("[data-line=delivery]")) == (wrong, [last])
    # The visitor flies on from before it.
    card.get_by_role("button", name="Try from step").click()
    expect(page).to_have_url(re.compile(f"fork={worst - 1}&of=random"))


@pytest.mark.feature("D2", "D3")
def test_mission_results_of_a_failure_lead_from_easy_to_medium_to_hard_to_easy(page: Page) -> None:
    over(page, 0, "/?task=easy&seed=0&pilots=random,optimal")
    fly(page)
    card = ended(page)
    expect(card.get_by_role("heading", name="Random: Battery empty.")).to_be_visible()
    expect(card.locator(".results-reason")).to_have_text("Each step costs a unit.")
    expect(card.locator(".points-legend span").first).to_have_text(f"{points(LOWEST)} lowest score")
    expect_efficiency(page, 0, 0)
    # With several flights, the card is about the one that is selected.
    page.keyboard.press("2")
    expect(card.get_by_role("heading", name="Optimal: All parcels delivered.")).to_be_visible()
    for after, steps in (("Medium", 100), ("Hard", 160), ("Easy", 60)):
        ended(page).get_by_role("button", name=f"Next: {after}").click()
        expect_step(page, 0, steps)
        expect_task(page, after)
        at_its_end(page, 0, f"/?task={after.lower()}&seed=0&pilot=optimal")
    expect_flying(page, "Optimal")
    # The other families end with their hardest task.
    at_its_end(page, 0, "/?task=skyline_hard&seed=0&pilot=optimal")
    expect(page.locator("#next")).to_be_hidden()


def test_the_next_standard_task_starts_by_itself_unless_the_visitor_stays(shared: Tabs) -> None:
    page = shared.open()
    page.clock.install()
    page.goto("/?task=medium&seed=0&pilots=random,optimal")
    counts = page.locator(".results-next")
    fly(page)
    expect(counts).to_contain_text(re.compile(r"Next: Hard in \d s"))
    press(page, "Stay")
    expect(counts).to_have_text("Go on by itself")
    # The choice is remembered, and a link counts nothing.
    page.reload()
    ended(page)
    expect(counts).to_be_hidden()
    press(page, "Reset")
    fly(page)
    expect(counts).to_have_text("Go on by itself")
    press(page, "Go on by itself")
    page.clock.run_for(5000)
    expect_task(page, "Hard")
    expect_flying(page, "Optimal", "Random")
    expect(page.locator("#step-counter")).to_contain_text(re.compile("Step [1-9]"))
    page.context.close()


@pytest.mark.parametrize(("seed", "x"), [(15, 0), pytest.param(75, 7, marks=pytest.mark.long)])
def test_the_card_is_over_the_map_but_not_over_the_drone_until_the_visitor_closes_it(
    page: Page, seed: int, x: int
) -> None:
    # Greedy begins on one side of the map and delivers on the other, in column x.
    over(page, seed, f"/?task=easy&seed={seed}&pilot=greedy")
    at_speed(page, FASTEST)
    page.locator("#step-counter").click()  # no button has the focus
    expect_step(page, 0, 60)
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_enabled()
    focused = page.evaluate("document.activeElement.id")
    page.keyboard.press("Enter")
    card, steps = ended(page), len(flown("easy", seed, "greedy").actions)
    expect(card).to_have_class(re.compile("over"))
    assert page.evaluate("document.activeElement.id") == focused, "the keys are still those of the flight"
    placed, field = box(page, ".results"), box(page, "#boards .map-air")
    assert field.left <= placed.left
    assert placed.left + placed.width <= field.left + field.width
    assert field.top <= placed.top
    assert placed.top + placed.height <= field.top + field.height
    # The city is a square in the middle of the field.
    side = min(field.width, field.height)
    cell = field.left + field.width / 2 + (x - 5) * side / 10
    assert placed.left + placed.width <= cell + 10 if x >= 5 else placed.left >= cell + side / 10 - 10
    # Who looks back sees the whole map.
    page.keyboard.press("ArrowLeft")
    expect_step(page, steps - 1, steps)
    expect(card).not_to_have_class(re.compile("over"))
    page.keyboard.press("End")
    expect(card).to_have_class(re.compile("over"))
    page.keyboard.press("Escape")
    expect(card).not_to_have_class(re.compile("over"))
    expect(card).to_be_visible()
    # A link to the finished flight shows the same card beside the map.
    expect(page).to_have_url(re.compile(f"step={steps}$"))
    page.reload()
    expect(ended(page)).not_to_have_class(re.compile("over"))


def test_a_file_may_hold_several_flights_or_an_unfinished_one(page: Page) -> None:
    forked = Provenance(pilot="human", person="Ada", undo_used=True, parent=Parent(pilot="greedy", step=2))
    flights = [flown("easy", 1, "greedy"), flown("medium", 2, "greedy"), flown("easy", 3, "optimal", label=forked)]
    view(page, "Fly")
    choice = choices(page).get_by_role("combobox", name="Flight of the file")
    open_file(page, "flights.jsonl", "".join(flight.to_json() + "\n" for flight in flights))
    choices(page)
    expect(choice.locator("option")).to_have_text(
        ["1. Easy, map 1, Greedy", "2. Medium, map 2, Greedy", "3. Easy, map 3, Ada with undo from step 2 of Greedy"]
    )
    for index in (1, 0):
        choice.select_option(index=index)
        expect(map_number(page)).to_have_value(str(flights[index].seed))
        expect(slider(page)).to_have_attribute("max", str(len(flights[index].actions)))
    open_file(page, "flight.json", record_of(Episode("easy", "tiered", 5).fly([Action.UP]), "me").to_json(2))
    expect(page.locator(".results")).to_contain_text("me: In flight.")
    expect(page.locator(".results")).to_contain_text("This flight is not finished")
    expect_step(page, 1, 60, "UP")


def test_beside_a_language_models_flight_stands_what_it_was_asked_and_answered(page: Page, server: Server) -> None:
    flights = get(server, "episodes", agent="scripted")["episodes"]
    id_ = next(one["id"] for one in flights if one["seed"] == 14)
    calls = get(server, f"episodes/{id_}/calls")["calls"]
    show(page, f"/?episode={id_}&step=0")
    answer, prompt = page.locator("#llm-answer"), page.locator("#llm-prompt")
    # The arrows are the values of a network that does not fly here.
    expect(page.get_by_role("checkbox", name="Network values")).to_be_hidden()
    assert painted(page.locator("#boards .map-air"), "--network") == []
    # Its first answer was not legal, so it was asked again.
    expect(answer).to_have_text(f"Hm. (illegal)\n\nRetry: {calls[1]['answer']['text']}")
    page.get_by_text("Prompt", exact=True).click()
    for call in calls[1:]:
        page.keyboard.press("ArrowRight")
        expect_step(page, call["turn"], len(calls) - 1)
        expect(prompt).to_have_text("\n\n".join(f"{one['role']}: {one['content']}" for one in call["messages"]))
        expect(answer).to_contain_text(call["answer"]["text"])
    expect(page.locator(".move-counts")).to_have_text("3 best")

    def unusable(route: Route) -> None:
        changed = [{**call, "outcome": "illegal"} if call["turn"] == 2 else call for call in calls]
        route.fulfill(json={"model": "scripted", "calls": changed})

    # A wait in place of an unusable answer is no move of the model.
    page.route("**/calls", unusable)
    page.reload()
    expect(page.locator(".move-counts")).to_have_text("2 best")
    expect(page.get_by_role("button", name="Step 2, ")).not_to_have_attribute("aria-label", re.compile("best"))
    page.unroute("**/calls")


def test_bad_files_are_refused_in_words_and_a_good_one_lends_its_map_to_what_is_flown_next(
    page: Page, shared: Tabs
) -> None:
    shared.expect("422")
    record = flown("easy", 21, "random", label="me")
    problem = page.locator("#view-fly").get_by_role("alert")
    forged = json.loads(record.to_json()) | {"score": 0.99}
    over(page, 7, "/?task=hard&seed=7&pilot=greedy")
    for name, text, says in (
        ("notes.txt", "hello", "must end in .json, .jsonl, .toml"),
        ("empty.json", " ", "empty.json contains 0 flights"),
        (
            "null.json",
            "null",
            "null.json is not a flight file. Body: Input should be a valid dictionary",
        ),
        ("map.toml", "hello = 1", "map.toml is not a map. Format: Field required; terrain: Field required; hello: "),
        ("two.jsonl", f"{record.to_json()}\n{{oops\n", "two.jsonl, line 2 is not a flight."),
        ("forged.json", json.dumps(forged), "forged.json is not a flight file. The record does not fit its flight: "),
    ):
        # The open choices would cover what the page says.
        choices(page)
        open_file(page, name, text)
        expect(problem).to_contain_text(says)
    # The flight before is still shown.
    expect(map_number(page)).to_have_value("7")
    choices(page)
    open_file(page, "flight.json", record.to_json(2))
    expect(page.locator(".results")).to_contain_text("me: ")
    expect(page.locator("#flight-file")).to_be_hidden()
    expect_step(page, len(record.actions), len(record.actions))
    expect(problem).to_be_hidden()
    pilot(page, "Greedy").click()
    expect(page.locator(".results")).to_be_hidden()
    expect_task(page, "Easy")
    expect_step(page, 0, 60)
    expect(map_number(page)).to_have_value("21")
