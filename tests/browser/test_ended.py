"""Flights that have ended: the strip under the map, stored flights by their link, and flights in files."""

import json
import re

import pytest
from playwright.sync_api import Page, expect

from drone_env.core.actions import Action
from drone_env.results.record import EpisodeRecord, parse_record, record_of
from tests.api.serving import Server
from tests.browser.flights import by_hand, flown, frames, get, newest, posted
from tests.browser.shown import expect_flying, expect_frame, expect_step, fixed, percent, points
from tests.browser.stage import ended, fly, map_number, open_file, opened, over, press, show, slider
from tests.browser.tabs import Tabs


def expect_efficiency(page: Page, done: float, left: float) -> None:
    """The strip shows three shares with their weights, and their sum."""
    expect(page.locator("#efficiency-parts")).to_have_text(
        f"Efficiency {fixed(75 * done + 25 * left, 1)} of 100: parcels delivered {percent(done)} (weight 75), "
        f"battery left {percent(left)} (weight 15), steps left {percent(left)} (weight 10)."
    )


@pytest.mark.feature("D2")
@pytest.mark.feature("D5")
def test_success_shows_the_optimum_the_worst_move_efficiency_and_all_flights(page: Page, server: Server) -> None:
    # Chance delivers on this map, but late: it loses points.
    record = flown("easy", 82, "random")
    flight, annotation = frames(server, record), posted(server, "annotate", record)
    steps = len(record.actions)
    over(page, 82, "/?task=easy&seed=82&pilot=random")
    fly(page)
    strip = ended(page)
    score, optimum = points(annotation["score"]), points(annotation["optimal_score"])
    expect(strip.get_by_role("heading", name="Random: All parcels delivered.")).to_be_visible()
    expect(strip).to_contain_text(
        f"Score {score} of {optimum} possible, lost {points(annotation['regret'])}, 1 of 1 parcels, "
        f"{steps} steps, a best flight takes {annotation['optimal_steps']}."
    )
    expect(page.locator("#announcer")).to_have_text(f"All parcels delivered. Score {score}.")
    left = 1 - steps / 60  # of the battery and of the steps: both are 60
    analysis = get(server, "analyse/easy")
    trend = analysis["success_trend"] * 100
    counted = strip.locator(".strip-analysis")
    expect(counted).to_contain_text("of Easy here, on average: score")
    expect(counted).to_contain_text(f"reward {fixed(analysis['average_reward'])}, ")
    expect(counted).to_contain_text(
        f"success {percent(analysis['success_rate'])} (trend {'+' * (trend >= 0)}{fixed(trend, 0)} points)"
    )
    for action, share in analysis["action_distribution"].items():
        expect(counted).to_contain_text(f"{action} {percent(share)}")
    expect_efficiency(page, 1, left)
    worst = max(annotation["moves"], key=lambda move: move["regret"])
    seen = strip.get_by_role("button", name=re.compile("^Worst move"))
    expect(seen).to_have_text(f"Worst move: step {worst['step']}, {worst['action']}, lost {points(worst['regret'])}")
    seen.click()
    expect_frame(page, flight[worst["step"]], 60)
    # The visitor flies on from before it.
    strip.get_by_role("button", name="Try from step").click()
    expect(page).to_have_url(re.compile(f"fork={worst['step'] - 1}&of=random"))


@pytest.mark.feature("D2")
def test_failure_says_why_and_no_dialog_opens(page: Page) -> None:
    over(page, 0, "/?task=easy&seed=0&pilots=random,optimal")
    fly(page)
    strip = ended(page)
    expect(strip.get_by_role("heading", name="Random: Battery empty.")).to_be_visible()
    expect(strip).to_contain_text("0 of 1 parcels, 60 steps")
    expect(page.get_by_role("dialog")).to_be_hidden()
    expect_efficiency(page, 0, 0)
    # With several flights, the strip is about the one that is selected.
    page.keyboard.press("2")
    expect(strip.get_by_role("heading", name="Optimal: All parcels delivered.")).to_be_visible()


@pytest.mark.feature("D3")
def test_from_easy_to_medium_to_hard_to_easy(page: Page) -> None:
    over(page, 14, "/?task=easy&seed=14&pilot=optimal")
    for name, after, steps in (("Easy", "Medium", 60), ("Medium", "Hard", 100), ("Hard", "Easy", 160)):
        expect_step(page, 0, steps)
        expect(page.get_by_role("radio", name=name, exact=True)).to_be_checked()
        fly(page)
        ended(page).get_by_role("button", name=f"Next: {after}").click()
    expect_step(page, 0, 60)
    expect_flying(page, "Optimal")


@pytest.fixture
def record() -> EpisodeRecord:
    return flown("easy", 21, "random", label="me")


def test_a_stored_flight_opens_from_its_link_with_slider_and_steps(page: Page, server: Server) -> None:
    episode = newest(server, 3, "medium")
    record = parse_record(server.client.get(f"/episodes/{episode['id']}").content, "it")
    flight, last = frames(server, record), episode["steps"]
    over(page, record.seed, f"/?episode={episode['id']}")
    for button, step in (("Step", 1), ("Last step", last), ("Step back", last - 1), ("First step", 0)):
        press(page, button)
        expect_frame(page, flight[step], 100)
    slider(page).fill("3")
    expect_frame(page, flight[3], 100)
    expect(page.locator(".strip")).to_contain_text(f"Greedy: All parcels delivered. Score {points(episode['score'])}")
    expect(page.get_by_role("radio", name="Medium", exact=True)).to_be_checked()
    here = f"{server.url}/?episode={episode['id']}&step=3"
    expect(page).to_have_url(here)


def test_a_file_may_hold_several_flights_or_an_unfinished_one(page: Page) -> None:
    flights = [flown("easy", 1, "greedy"), flown("medium", 2, "greedy"), flown("easy", 3, "optimal")]
    choice = page.get_by_role("combobox", name="Flight of the file")
    open_file(page, "flights.jsonl", "".join(flight.to_json() + "\n" for flight in flights))
    expect(choice.locator("option")).to_have_text(
        ["1. Easy, map 1, Greedy", "2. Medium, map 2, Greedy", "3. Easy, map 3, Optimal"]
    )
    for index in (1, 0):
        choice.select_option(index=index)
        expect(map_number(page)).to_have_value(str(flights[index].seed))
        expect(slider(page)).to_have_attribute("max", str(len(flights[index].actions)))
    opened(page, record_of(by_hand("easy", 5, [Action.UP]), "me"))
    expect(page.locator(".strip")).to_contain_text("me: In flight. This flight is not finished")
    page.keyboard.press("End")
    expect_step(page, 1, 60, "UP")


def test_a_flight_of_the_past_lends_its_map_to_what_is_flown_next(page: Page, record: EpisodeRecord) -> None:
    show(page, "/?task=hard&seed=7&pilot=greedy")
    expect_step(page, 0, 160)
    opened(page, record)
    press(page, "Greedy")
    expect(page.locator(".strip")).to_be_hidden()
    expect(page.get_by_role("radio", name="Easy", exact=True)).to_be_checked()
    expect_step(page, 0, 60)
    expect(map_number(page)).to_have_value("21")


def test_beside_a_language_models_flight_stands_what_it_was_asked_and_answered(page: Page, server: Server) -> None:
    flights = get(server, "episodes", agent="scripted")["episodes"]
    id_ = next(one["id"] for one in flights if one["seed"] == 14)
    calls = get(server, f"episodes/{id_}/calls")["calls"]
    show(page, f"/?episode={id_}")
    answer, prompt = page.locator("#llm-answer"), page.locator("#llm-prompt")
    # Its first answer was not legal, so it was asked again.
    expect(answer).to_have_text(f"Hm. (illegal)\n\nRetry: {calls[1]['answer']}")
    page.get_by_text("Prompt", exact=True).click()
    for call in calls[1:]:
        page.keyboard.press("ArrowRight")
        expect_step(page, call["step"], len(calls) - 1)
        expect(prompt).to_have_text("\n\n".join(f"{one['role']}: {one['content']}" for one in call["messages"]))
        expect(answer).to_contain_text(call["answer"])


def test_bad_files_are_refused_in_words(page: Page, shared: Tabs, record: EpisodeRecord) -> None:
    shared.expect("422")
    problem = page.locator("#view-fly").get_by_role("alert")
    forged = json.loads(record.to_json()) | {"score": 0.99}
    over(page, 7, "/?task=easy&seed=7&pilot=greedy")
    for name, text, says in (
        ("notes.txt", "hello", "must end in .json or .jsonl"),
        ("empty.json", " ", "is empty"),
        ("two.jsonl", f"{record.to_json()}\n{{oops\n", "two.jsonl, line 2 is not JSON"),
        ("forged.json", json.dumps(forged), "does not fit its flight: score 0.99"),
    ):
        open_file(page, name, text)
        expect(problem).to_contain_text(says)
    # The flight before is still shown.
    expect(map_number(page)).to_have_value("7")
    opened(page, record)
    expect(problem).to_be_hidden()
