"""Flights of the past: stored ones by their link, and those in files."""

import json
import re
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from drone_env.core.actions import Action
from drone_env.results.record import EpisodeRecord, parse_record, record_of
from tests.api.serving import Server
from tests.browser.flights import by_hand, flown, frames, get, newest
from tests.browser.shown import expect_frame, expect_step, points
from tests.browser.stage import at_speed, copied, dropped, map_number, opened, over, press, show, slider
from tests.browser.tabs import Tabs


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
        expect(slider(page)).to_have_value(str(step))
    slider(page).fill("3")
    expect_frame(page, flight[3], 100)
    expect_step(page, 3, last, flight[3]["action"])
    expect(slider(page)).to_have_attribute("aria-valuetext", re.compile(re.escape(f"Step 3: {flight[3]['message']}")))
    expect(page.locator(".strip")).to_contain_text(f"Greedy: All parcels delivered. Score {points(episode['score'])}")
    expect(page.get_by_role("radio", name="Medium", exact=True)).to_be_checked()
    here = f"{server.url}/?episode={episode['id']}&step=3"
    expect(page).to_have_url(here)
    # A file has an address of its own while the page has it, and no link.
    other = flown("easy", 7, "greedy", label="me")
    opened(page, other)
    expect(page).to_have_url(f"{server.url}/?file=flight.json")
    copied(page, "Copy link to this moment", "No link leads to a file")
    page.go_back()
    expect(page).to_have_url(here)
    expect_frame(page, flight[3], 100)
    page.go_forward()
    expect_frame(page, frames(server, other)[0], 60)
    page.reload()
    expect(page.get_by_role("alert")).to_contain_text("The file flight.json is on this page no more: open it again.")


def test_it_plays_by_itself_at_the_chosen_speed_and_by_keys(page: Page) -> None:
    record = flown("medium", 7, "random", label="me")
    last = len(record.actions)
    opened(page, record)
    at_speed(page, "15")
    play = page.get_by_role("button", name="Play", exact=True)
    play.click()
    expect(slider(page)).to_have_value(re.compile("[1-9]"))
    # A click works although steps are shown while the button is held down.
    page.get_by_role("button", name="Pause", exact=True).hover()
    page.mouse.down()
    at = slider(page).input_value()
    expect(slider(page)).not_to_have_value(at)
    page.mouse.up()
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    at = slider(page).input_value()
    # Timers end in the order of their time: a step still to come would come before the end of this one.
    page.evaluate("() => new Promise(done => setTimeout(done, 3 * 1000 / 15))")
    assert slider(page).input_value() == at
    slider(page).fill(str(last - 2))
    play.click()
    expect(slider(page)).to_have_value(str(last))
    expect(play).to_be_visible()
    # At the end, space plays from the start.
    page.locator("#step-counter").click()
    page.keyboard.press(" ")
    expect(slider(page)).to_have_value(re.compile("^[1-9][0-9]?$"))
    page.keyboard.press(" ")
    expect(play).to_be_visible()


def test_a_file_may_hold_several_flights_or_an_unfinished_one(page: Page, tmp_path: Path) -> None:
    flights = [flown("easy", 1, "greedy"), flown("medium", 2, "greedy"), flown("easy", 3, "optimal")]
    file = tmp_path / "flights.jsonl"
    file.write_text("".join(flight.to_json() + "\n" for flight in flights), encoding="utf-8")
    show(page, "/?task=easy&seed=7&pilot=greedy")
    choice = page.get_by_role("combobox", name="Flight of the file")
    expect(map_number(page)).to_have_value("7")
    expect(choice).to_be_hidden()
    page.get_by_label("Open a file…").set_input_files(file)
    expect(choice.locator("option")).to_have_text(
        ["1. Easy, map 1, Greedy", "2. Medium, map 2, Greedy", "3. Easy, map 3, Optimal"]
    )
    for index in (1, 2, 0):
        choice.select_option(index=index)
        expect(map_number(page)).to_have_value(str(flights[index].seed))
        expect(slider(page)).to_have_attribute("max", str(len(flights[index].actions)))
    page.go_back()
    expect(map_number(page)).to_have_value("7")
    expect(choice).to_be_hidden()
    opened(page, record_of(by_hand("easy", 5, [Action.UP]), "me"))
    expect(page.locator(".strip")).to_contain_text("me: In flight. This flight did not end")
    page.keyboard.press("End")
    expect_step(page, 1, 60, "UP")
    expect(page.locator("#score-note")).to_have_text("provisional")
    expect(page.locator("#worst")).to_be_hidden()


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
    expect(answer).to_have_text(f"Hm. (illegal)\n\nAsked again: {calls[1]['answer']}")
    page.get_by_text("What it was asked").click()
    for call in calls[1:]:
        page.keyboard.press("ArrowRight")
        expect_step(page, call["step"], len(calls) - 1)
        expect(prompt).to_have_text("\n\n".join(f"{one['role']}: {one['content']}" for one in call["messages"]))
        expect(answer).to_contain_text(call["answer"])
    # A prompt with a picture shows the map as it was then.
    parts = [{"type": "image_url", "image_url": {"url": "drone-env:picture?seed=3"}}, {"type": "text", "text": "Fly!"}]
    call = {"step": 2, "attempt": 1, "messages": [{"role": "user", "content": parts}], "answer": "UP", "outcome": "ok"}
    show(page, "/?task=easy&seed=7&pilot=greedy")
    expect(answer).to_be_hidden()
    page.route("**/calls", lambda route: route.fulfill(json={"model": "sees", "calls": [call]}))
    show(page, f"/?episode={id_}&step=2")
    expect_step(page, 2, 3)
    page.get_by_text("What it was asked").click()
    expect(prompt).to_have_text("user: [drone-env:picture?seed=3]\nFly!")
    expect(page.locator(".asked")).to_have_attribute("src", f"preview.png?episode={id_}&step=1")
    expect(page.locator(".asked")).to_have_js_property("naturalWidth", 1200)
    page.unroute("**/calls")


def test_bad_files_are_refused_in_words(page: Page, shared: Tabs, record: EpisodeRecord) -> None:
    shared.expect("422")
    problem = page.locator("#view-fly").get_by_role("alert")
    forged = json.loads(record.to_json()) | {"score": 0.99}
    show(page, "/?task=easy&seed=7&pilot=greedy")
    for name, text, says in (
        ("notes.txt", "hello", "must end in .json or .jsonl"),
        ("empty.json", " ", "is empty"),
        ("two.jsonl", f"{record.to_json()}\n{{oops\n", "two.jsonl, line 2 is not JSON"),
        ("forged.json", json.dumps(forged), "does not fit its flight: score 0.99"),
    ):
        dropped(page, name, text)
        expect(problem).to_contain_text(says)
    # The flight before is still shown.
    expect(map_number(page)).to_have_value("7")
    opened(page, record)
    expect(problem).to_be_hidden()
