"""One pilot: instruments, transport, graph, thoughts, files and the map."""

import json
import re
from collections.abc import Callable

import pytest
from playwright.sync_api import Page, WebSocketRoute, expect

from drone_env.results.record import parse_record
from tests.api.serving import Server
from tests.browser.flights import flown, frames, posted
from tests.browser.shown import (
    counter,
    expect_flying,
    expect_frame,
    expect_step,
    fixed,
    painted,
    pictures,
    points,
)
from tests.browser.stage import at_its_end, at_speed, ended, fly, map_number, moves, over, pilot, press, slider, until


def test_it_waits_for_start_shows_each_step_as_the_server_has_it_and_saves_them(page: Page, server: Server) -> None:
    record = flown("medium", 7, "greedy")
    flight = frames(server, record)
    over(page, 7, "/?task=medium&seed=7&pilot=greedy")
    expect_frame(page, flight[0], 100)
    for frame in flight[1:4]:
        press(page, "Step")
        expect_frame(page, frame, 100)
    expect(page.locator("#move-detail")).to_contain_text(flight[3]["message"])
    # There is no record before the end.
    expect(page.get_by_role("button", name="Save record", exact=True)).to_be_disabled()
    fly(page, "Resume")
    ended(page)
    with page.expect_download() as saved:
        press(page, "Save record")
    assert saved.value.suggested_filename == "medium-7-greedy.json"
    assert parse_record(saved.value.path().read_bytes(), "it") == record


@pytest.mark.feature("D1")
def test_start_pause_a_step_go_on_the_end_play_it_again_reset_and_a_new_map(page: Page, server: Server) -> None:
    flight = frames(server, flown("easy", 6, "greedy"))
    over(page, 6, "/?task=easy&seed=6&pilot=greedy")
    at_speed(page, "2")  # slow enough that it does not end before the pause
    press(page, "Start")
    expect(page.get_by_role("button", name="Step", exact=True)).to_be_disabled()
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step ([2-9]|[1-9][0-9]) of 60"))
    press(page, "Pause")
    expect(page.get_by_role("button", name="Resume", exact=True)).to_be_visible()
    at = counter(page)
    assert at < len(flight) - 1
    press(page, "Step")
    expect_frame(page, flight[at + 1], 60)
    fly(page, "Resume")
    ended(page)
    # The keys still work after a click on a button that then is disabled and has the focus.
    press(page, "First step")
    page.keyboard.press("ArrowRight")
    expect_frame(page, flight[1], 60)
    page.locator("#step-counter").click()
    page.keyboard.press("Space")
    expect_frame(page, flight[-1], 60)
    press(page, "Reset")
    expect_frame(page, flight[0], 60)
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_visible()
    press(page, "New map")
    expect(map_number(page)).not_to_have_value(re.compile("^6?$"))
    expect_step(page, 0, 60)


@pytest.mark.feature("D1")
def test_the_network_shows_what_it_thinks_of_each_move(page: Page, server: Server) -> None:
    flight = frames(server, flown("hard", 7, "pathqnet"))
    over(page, 7, "/?task=hard&seed=7&pilot=pathqnet")
    expect_frame(page, flight[0], 160)
    press(page, "Step")
    expect_frame(page, flight[1], 160)
    thoughts = page.get_by_role("table", name="Each move from here")
    ranked = sorted(flight[1]["q_values"].items(), key=lambda pair: -pair[1])
    for action, value in ranked:
        row = thoughts.get_by_role("row").filter(has_text=action)
        expect(row.get_by_role("cell").first).to_have_text(fixed(value, 3))
    (best, most), (second, less) = ranked[:2]
    expect(page.locator("#confidence")).to_have_text(f"The network's {best} leads {second} by {fixed(most - less, 3)}.")
    expect(thoughts.locator("tr:has(td.best)")).to_contain_text([best])


def test_the_graph_shows_what_was_possible_and_leads_to_each_moment(page: Page, server: Server) -> None:
    # Chance delivers on this map, but late: it loses points.
    record = flown("easy", 82, "random")
    flight, annotation = frames(server, record), posted(server, "annotate", record)
    annotated, last = annotation["moves"], len(flight) - 1
    at_its_end(page, 82, "/?task=easy&seed=82&pilot=random")
    bounds = slider(page).bounding_box()
    assert bounds
    worst = max(annotated, key=lambda move: move["regret"])["step"]
    page.mouse.click(bounds["x"] + bounds["width"] * worst / last, bounds["y"] + bounds["height"] / 2)
    expect_frame(page, flight[worst], 60)
    possible, move = annotated[worst]["value"], annotated[worst - 1]
    expect(page.locator("#possible")).to_have_text(points(possible))
    expect(page.locator("#lost")).to_have_text(points(annotation["optimal_score"] - possible))
    lost = f"{move['label']}: lost {points(move['regret'])}. {points(possible)} still possible."
    expect(slider(page)).to_have_attribute("aria-valuetext", f"Step {worst}: {flight[worst]['message']} {lost}")
    # The keys of the page still work after a click on a move, which has the focus.
    page.keyboard.press("Home")
    moves(page).nth(worst - 1).click()
    expect(moves(page).nth(worst - 1)).to_have_attribute("aria-current", "step")
    expect_frame(page, flight[worst], 60)
    lost = f"Lost {points(move['regret'], 2)}. Best move: {' or '.join(move['best_actions'])}."
    expect(page.locator("#move-detail")).to_contain_text(lost)
    page.keyboard.press("ArrowRight")  # the line of the moment lies beside the mark
    expect_frame(page, flight[worst + 1], 60)
    pictures(page)  # drawn
    graph = page.locator(".timeline-graph")
    marked = {at for at in range(1, last) if painted(graph, "--bad", "--warn", "--accent", across=at / last)}
    assert marked == {move["step"] for move in annotated if move["label"] not in ("best", "good")} - {last}
    assert painted(graph, "--map-box", across=1), "where the parcel is delivered"


def test_the_answer_to_an_older_choice_does_not_undo_a_newer_one(beside: Callable[..., Page]) -> None:
    page, held = beside(), list[Callable[[], None]]()

    def hold_the_flights(socket: WebSocketRoute) -> None:
        def answer(text: str | bytes) -> None:
            if json.loads(text)["type"] == "flights":
                held.append(lambda: socket.send(text))
            else:
                socket.send(text)

        socket.connect_to_server().on_message(answer)

    page.route_web_socket("**/live", hold_the_flights)
    page.goto("/?task=easy&seed=3&pilot=greedy")
    until(page, lambda: bool(held))
    pilot(page, "You").click()
    map_number(page).fill("7")
    map_number(page).press("Enter")
    for _ in range(2):
        held.pop(0)()
        until(page, lambda: bool(held))
        expect_step(page, 0, 60)
        expect_flying(page, "You")
        expect(map_number(page)).to_have_value("7")
    held.pop(0)()
    page.get_by_role("group", name="Fly").get_by_role("button", name="Wait", exact=True).click()
    expect_step(page, 1, 60)
