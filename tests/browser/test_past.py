"""Flights of the past: stored ones by their link, and those in files."""

import json
import re
from pathlib import Path

import pytest
from playwright.sync_api import Locator, Page, expect

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.results.record import EpisodeRecord, parse_record, record_of
from tests.api.serving import Server
from tests.browser.flights import flown, frames, posted
from tests.browser.stage import dropped, expect_frame, opened, over, points, show, slider
from tests.browser.tabs import Tabs


def moves(page: Page) -> Locator:
    return page.get_by_role("list", name="Moves").get_by_role("button")


@pytest.fixture
def record() -> EpisodeRecord:
    return flown("easy", 21, "random", label="me")


def test_a_stored_flight_opens_from_its_link_with_slider_and_steps(page: Page, server: Server) -> None:
    episode = server.client.get("/episodes", params={"task": "medium", "agent": "greedy"}).json()["episodes"][0]
    record = parse_record(server.client.get(f"/episodes/{episode['id']}").content, "it")
    flight, last = frames(server, record), episode["steps"]
    over(page, record.seed, f"/?episode={episode['id']}")
    expect_frame(page, flight[0], 100)
    for button, step in (("Step", 1), ("Last step", last), ("Step back", last - 1), ("First step", 0)):
        page.get_by_role("button", name=button, exact=True).click()
        expect_frame(page, flight[step], 100)
        expect(slider(page)).to_have_value(str(step))
    slider(page).fill("3")
    expect_frame(page, flight[3], 100)
    expect(page.locator("#step-counter")).to_contain_text(f"Step 3 of {last} · {flight[3]['action']}")
    expect(slider(page)).to_have_attribute("aria-valuetext", re.compile(re.escape(f"Step 3: {flight[3]['message']}")))
    expect(page.locator(".strip")).to_contain_text(f"Greedy: All parcels delivered. Score {points(episode['score'])}")
    # What stands there is the flight of that map: it is what can be chosen from.
    expect(page.get_by_role("radio", name="Medium", exact=True)).to_be_checked()
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value(str(episode["seed"]))
    here = f"{server.url}/?episode={episode['id']}&step=3"
    expect(page).to_have_url(here)
    # A file has an address of its own while the page has it, and no link.
    other = flown("easy", 7, "greedy", label="me")
    opened(page, other)
    expect(page).to_have_url(f"{server.url}/?file=flight.json")
    page.get_by_role("button", name="Copy link to this moment").click()
    expect(page.locator("#toasts")).to_contain_text("No link leads to a file")
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
    page.get_by_role("combobox", name="Speed").select_option("15")
    play = page.get_by_role("button", name="Play", exact=True)
    play.click()
    expect(slider(page)).to_have_value(re.compile("[1-9]"))
    # Steps that are shown while it is held down take nothing from a click.
    page.get_by_role("button", name="Pause", exact=True).hover()
    page.mouse.down()
    at = slider(page).input_value()
    expect(slider(page)).not_to_have_value(at)
    page.mouse.up()
    # What is shown by then is drawn in the next frame.
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")
    at = slider(page).input_value()
    # Timers end in the order of their time: a step that was still to come would come before this one's end.
    page.evaluate("() => new Promise(done => setTimeout(done, 3 * 1000 / 15))")
    assert slider(page).input_value() == at
    slider(page).fill(str(last - 2))
    play.click()
    expect(slider(page)).to_have_value(str(last))
    expect(play).to_be_visible()
    # A button that was pressed keeps the focus, and takes no arrows.
    page.get_by_role("button", name="Step back").click()
    keys = {"ArrowLeft": last - 2, "Home": 0, "ArrowRight": 1, ".": 2, "End": last}
    for key, step in keys.items():
        page.keyboard.press(key)
        expect(slider(page)).to_have_value(str(step))
    page.locator("#step-counter").click()
    # From its end it is played from the start.
    page.keyboard.press(" ")
    expect(slider(page)).to_have_value(re.compile("^[1-9][0-9]?$"))
    page.keyboard.press(" ")
    expect(play).to_be_visible()


def test_the_moves_are_annotated_and_jump_to_their_step(page: Page, server: Server, record: EpisodeRecord) -> None:
    annotation = posted(server, "annotate", record)
    marked = [move for move in annotation["moves"] if move["mark"]]
    assert marked, "a flight at random must have given something away"
    opened(page, record)
    expect(moves(page)).to_have_count(len(annotation["moves"]))
    for label, count in annotation["counts"].items():
        expect(page.locator(f"#moves button[data-label={label}]")).to_have_count(count)
    strip = page.locator(".strip")
    expect(strip).to_contain_text(f"of {points(annotation['optimal_score'])} possible, ")
    expect(strip).to_contain_text(f"lost {points(annotation['regret'])}, 1 of 1 parcels, {len(record.actions)} steps, ")
    expect(strip).to_contain_text(f"a best flight takes {annotation['optimal_steps']}.")
    move = marked[0]
    entry = page.get_by_role("button", name=f"Step {move['step']}, {move['action']}, {move['label']}", exact=True)
    expect(entry).to_contain_text(move["mark"])
    entry.click()
    expect(slider(page)).to_have_value(str(move["step"]))
    expect(page.locator("#move-detail")).to_contain_text(f"best was {' or '.join(move['best_actions'])}.")
    worst = max(annotation["moves"], key=lambda one: one["regret"])
    page.locator("#worst").click()
    expect(slider(page)).to_have_value(str(worst["step"]))
    expect(page.locator("#possible")).to_have_text(points(worst["value"] - worst["regret"]))


def test_a_file_with_several_flights_offers_them(page: Page, tmp_path: Path) -> None:
    flights = [flown("easy", 1, "greedy"), flown("medium", 2, "greedy"), flown("easy", 3, "optimal")]
    file = tmp_path / "flights.jsonl"
    file.write_text("".join(flight.to_json() + "\n" for flight in flights), encoding="utf-8")
    show(page, "/?task=easy&seed=7&pilot=greedy")
    choice = page.get_by_role("combobox", name="Flight of the file")
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value("7")
    expect(choice).to_be_hidden()
    page.get_by_label("Open a file…").set_input_files(file)
    expect(choice.locator("option")).to_have_text(
        ["1. Easy, map 1, Greedy", "2. Medium, map 2, Greedy", "3. Easy, map 3, Optimal"]
    )
    for index, seed in ((1, "2"), (2, "3"), (0, "1")):
        choice.select_option(index=index)
        expect(page.get_by_role("spinbutton", name="Map")).to_have_value(seed)
        expect(slider(page)).to_have_attribute("max", str(len(flights[index].actions)))
    expect(choice).to_have_value("1. Easy, map 1, Greedy")
    # Where something else stands there, it offers nothing.
    page.go_back()
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value("7")
    expect(choice).to_be_hidden()


def test_the_record_that_is_downloaded_is_the_record(page: Page, record: EpisodeRecord) -> None:
    opened(page, record)
    with page.expect_download() as saved:
        page.get_by_role("button", name="Record", exact=True).click()
    assert saved.value.suggested_filename == "easy-21-me.json"
    assert parse_record(saved.value.path().read_bytes(), "it") == record


def test_an_unfinished_flight_is_shown_without_annotation(page: Page) -> None:
    episode = Episode("easy", "tiered")
    episode.reset(5)
    episode.step(Action.UP)
    opened(page, record_of(episode, "me"))
    expect(page.locator(".strip")).to_contain_text("me: In flight. This flight did not end")
    page.keyboard.press("End")
    expect(page.locator("#step-counter")).to_contain_text("Step 1 of 60 · UP")
    expect(page.locator("#score-note")).to_have_text("provisional")
    expect(moves(page)).to_have_count(1)
    expect(page.locator("#worst")).to_be_hidden()
    expect(page.locator("#toasts .toast")).to_have_count(0)


def test_a_flight_of_the_past_lends_its_map_to_what_is_flown_next(page: Page, record: EpisodeRecord) -> None:
    seed = page.get_by_role("spinbutton", name="Map")
    for press, task, map_, steps in (
        (lambda: page.get_by_role("button", name="Greedy", exact=True).click(), "Easy", "21", 60),
        (lambda: page.get_by_role("button", name="Reset").click(), "Easy", "21", 60),
        (lambda: page.get_by_role("button", name="New map").click(), "Easy", re.compile("^(?!21$)[0-9]+$"), 60),
        (lambda: (seed.fill("8"), seed.press("Enter")), "Easy", "8", 60),
    ):
        show(page, "/?task=hard&seed=7&pilot=greedy")
        expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
        opened(page, record)
        press()
        expect(page.locator(".strip")).to_be_hidden()
        expect(page.get_by_role("radio", name=task, exact=True)).to_be_checked()
        expect(page.locator("#step-counter")).to_have_text(f"Step 0 of {steps}")
        expect(seed).to_have_value(map_)


def test_beside_a_language_models_flight_stands_what_it_was_asked_and_answered(page: Page, server: Server) -> None:
    flights = server.client.get("/episodes", params={"agent": "scripted"}).json()["episodes"]
    id_ = next(one["id"] for one in flights if one["seed"] == 14)
    calls = server.client.get(f"/episodes/{id_}/calls").json()["calls"]
    # Its first answer was none: it was asked again.
    assert [(call["step"], call["answer"], call["outcome"]) for call in calls[:1]] == [(1, "Hm.", "illegal")]
    show(page, f"/?episode={id_}")
    answer, prompt = page.locator("#llm-answer"), page.locator("#llm-prompt")
    expect(answer).to_have_text(f"Hm. (illegal)\n\nAsked again: {calls[1]['answer']}")
    page.get_by_text("What it was asked").click()
    for call in calls[1:]:
        page.keyboard.press("ArrowRight")
        expect(page.locator("#step-counter")).to_contain_text(f"Step {call['step']} of {len(calls) - 1}")
        expect(prompt).to_have_text("\n\n".join(f"{one['role']}: {one['content']}" for one in call["messages"]))
        expect(answer).to_contain_text(call["answer"])
    show(page, "/?task=easy&seed=7&pilot=greedy")
    expect(answer).to_be_hidden()


def test_of_a_prompt_with_a_picture_the_map_is_shown_as_it_stood(page: Page, server: Server) -> None:
    flights = server.client.get("/episodes", params={"agent": "scripted"}).json()["episodes"]
    id_ = next(one["id"] for one in flights if one["seed"] == 14)
    parts = [{"type": "image_url", "image_url": {"url": "drone-env:picture?seed=3"}}, {"type": "text", "text": "Fly!"}]
    call = {"step": 2, "attempt": 1, "messages": [{"role": "user", "content": parts}], "answer": "UP", "outcome": "ok"}
    page.route("**/calls", lambda route: route.fulfill(json={"model": "sees", "calls": [call]}))
    show(page, f"/?episode={id_}")
    expect(page.locator(".strip")).to_be_visible()
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#step-counter")).to_contain_text("Step 2 of 3")
    page.get_by_text("What it was asked").click()
    expect(page.locator("#llm-prompt")).to_have_text("user: [drone-env:picture?seed=3]\nFly!")
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
        ("list.json", "[1]", "is not the record of a flight"),
        ("two.jsonl", f"{record.to_json()}\n{{oops\n", "two.jsonl, line 2 is not JSON"),
        ("forged.json", json.dumps(forged), "does not fit its flight: score 0.99"),
        ("other.json", "{}", "this is not a flight: one is a JSON object"),
    ):
        dropped(page, name, text)
        expect(problem).to_contain_text(says)
    # What stood there is still there.
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value("7")
    opened(page, record)
    expect(problem).to_be_hidden()
