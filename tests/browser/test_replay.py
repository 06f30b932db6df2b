"""Replays: of stored episodes by their link, and of files."""

import json
import re
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import Locator, Page, expect

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.episodes.record import EpisodeRecord, parse_record, record_of
from tests.api.serving import Server
from tests.browser.flights import flown
from tests.browser.stage import fixed, points, view
from tests.browser.tabs import Tabs


def slider(page: Page) -> Locator:
    return page.get_by_role("slider", name="Step of the flight")


def facts(page: Page) -> dict[str, str]:
    """What stands beside the map, by its names."""
    pairs = page.locator(".facts > div").evaluate_all("all => all.map(e => [...e.children].map(c => c.textContent))")
    return dict(pairs)


def posted(server: Server, path: str, record: EpisodeRecord) -> dict[str, Any]:
    answer = httpx.post(f"{server.url}/{path}", json=json.loads(record.to_json()), timeout=60)
    answer.raise_for_status()
    return answer.json()


@pytest.fixture
def record() -> EpisodeRecord:
    return flown("easy", 21, "random", label="me")


def dropped(page: Page, name: str, text: str) -> None:
    """Drop a file on the page."""
    transfer = page.evaluate_handle(
        "([name, text]) => { const t = new DataTransfer(); t.items.add(new File([text], name)); return t; }",
        [name, text],
    )
    for event in ("dragover", "drop"):
        page.dispatch_event("main", event, {"dataTransfer": transfer})


def replayed(page: Page, record: EpisodeRecord) -> None:
    """Drop a record on the page, and wait until it stands there."""
    view(page, "Replay")
    dropped(page, "flight.json", record.to_json(2))
    expect(page.locator(".replay-title")).to_contain_text(f"map {record.seed}, flown by {record.agent}")
    expect(slider(page)).to_have_attribute("max", str(len(record.actions)))


def test_an_episode_replays_from_its_link_with_slider_and_steps(page: Page, server: Server) -> None:
    episode = httpx.get(f"{server.url}/episodes", params={"task": "medium", "agent": "greedy"}).json()["episodes"][0]
    record = parse_record(httpx.get(f"{server.url}/episodes/{episode['id']}").content, "it")
    frames = posted(server, "replay", record)["frames"]
    page.goto(f"/?episode={episode['id']}")
    where = page.locator("#replay-step")
    expect(where).to_contain_text(f"Step 0 of {episode['steps']}")
    page.get_by_role("button", name="Step forward").click()
    expect(where).to_contain_text(f"Step 1 of {episode['steps']} · {frames[1]['action']}")
    page.get_by_role("button", name="Last step").click()
    expect(where).to_contain_text(f"total {fixed(frames[-1]['reward_total'])}")
    expect(slider(page)).to_have_value(str(episode["steps"]))
    page.get_by_role("button", name="Step back").click()
    expect(slider(page)).to_have_value(str(episode["steps"] - 1))
    slider(page).fill("3")
    expect(where).to_contain_text(f"Step 3 of {episode['steps']} · {frames[3]['action']}")
    assert facts(page)["Score"] == points(episode["score"])
    # A file has no address: the one of the episode is a step back.
    replayed(page, flown("easy", 7, "greedy", label="me"))
    expect(page).to_have_url(f"{server.url}/?view=replay")
    page.go_back()
    expect(page.locator(".replay-title")).to_contain_text(f"map {episode['seed']}, flown by greedy")
    expect(page).to_have_url(f"{server.url}/?episode={episode['id']}")


def test_it_plays_by_itself_at_the_chosen_speed_and_by_keys(page: Page) -> None:
    record = flown("medium", 7, "random", label="me")
    replayed(page, record)
    page.get_by_role("combobox", name="Speed").select_option("15")
    page.get_by_role("button", name="Play").click()
    expect(slider(page)).to_have_value(re.compile("[1-9]"))
    page.get_by_role("button", name="Pause").click()
    at = slider(page).input_value()
    # Timers end in the order of their time: a step that was still to come would come before this one's end.
    page.evaluate("() => new Promise(done => setTimeout(done, 3 * 1000 / 15))")
    assert slider(page).input_value() == at
    slider(page).fill(str(len(record.actions) - 2))
    page.get_by_role("button", name="Play").click()
    expect(slider(page)).to_have_value(str(len(record.actions)))
    expect(page.get_by_role("button", name="Play")).to_be_visible()
    page.get_by_role("heading", name=re.compile("flown by me")).click()
    for key, step in (
        ("Home", 0),
        ("ArrowRight", 1),
        ("ArrowRight", 2),
        ("ArrowLeft", 1),
        ("End", len(record.actions)),
    ):
        page.keyboard.press(key)
        expect(slider(page)).to_have_value(str(step))
    # A button that was pressed keeps the focus, and takes no arrows.
    page.get_by_role("button", name="Step back").click()
    page.keyboard.press("ArrowLeft")
    expect(slider(page)).to_have_value(str(len(record.actions) - 2))


def test_the_moves_are_annotated_and_jump_to_their_step(page: Page, server: Server, record: EpisodeRecord) -> None:
    annotation = posted(server, "annotate", record)
    marked = [move for move in annotation["moves"] if move["mark"]]
    assert marked, "a flight at random must have given something away"
    replayed(page, record)
    moves = page.locator(".replay-moves")
    expect(moves.get_by_role("button")).to_have_count(len(annotation["moves"]))
    for label, count in annotation["counts"].items():
        expect(moves.locator(f"button[data-label={label}]")).to_have_count(count)
    shown = facts(page)
    assert shown["Regret"] == points(annotation["regret"])
    assert shown["Optimum"] == f"{points(annotation['optimal_score'])} in {annotation['optimal_steps']} steps"
    move = marked[0]
    entry = moves.get_by_role("button", name=f"Step {move['step']}, {move['action']}, {move['label']}", exact=True)
    expect(entry).to_contain_text(move["mark"])
    entry.click()
    expect(slider(page)).to_have_value(str(move["step"]))


def test_a_file_with_several_flights_offers_them(page: Page, tmp_path: Path) -> None:
    flights = [flown("easy", 1, "greedy"), flown("medium", 2, "greedy"), flown("easy", 3, "optimal")]
    file = tmp_path / "flights.jsonl"
    file.write_text("".join(flight.to_json() + "\n" for flight in flights), encoding="utf-8")
    view(page, "Replay")
    page.get_by_label("Open a file…").set_input_files(file)
    choice = page.get_by_role("combobox", name="Flight", exact=True)
    expect(choice.locator("option")).to_have_count(3)
    choice.select_option(index=1)
    expect(page.get_by_role("heading", name="Medium Delivery, map 2, flown by greedy")).to_be_visible()
    expect(slider(page)).to_have_attribute("max", str(len(flights[1].actions)))


def test_the_record_that_is_downloaded_is_the_record(page: Page, record: EpisodeRecord) -> None:
    replayed(page, record)
    with page.expect_download() as saved:
        page.get_by_role("button", name="Download record").click()
    assert saved.value.suggested_filename == "easy_delivery-21-me.json"
    assert parse_record(saved.value.path().read_bytes(), "it") == record


def test_an_unfinished_flight_replays_without_annotation(page: Page) -> None:
    episode = Episode("easy", "tiered")
    episode.reset(5)
    episode.step(Action.UP)
    view(page, "Replay")
    dropped(page, "flight.json", record_of(episode, "me").to_json())
    expect(page.get_by_text("This flight did not end")).to_be_visible()
    assert facts(page)["Outcome"] == "In flight"


def test_bad_files_are_refused_in_words(page: Page, shared: Tabs, record: EpisodeRecord) -> None:
    shared.expect("422")
    view(page, "Replay")
    problem = page.locator("#view-replay").get_by_role("alert")
    forged = json.loads(record.to_json()) | {"score": 0.99}
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
    dropped(page, "good.json", record.to_json())
    expect(page.get_by_role("heading", name="Easy Delivery, map 21, flown by me")).to_be_visible()
    expect(problem).to_be_hidden()
