"""One pilot: instruments, transport, graph, thoughts, files and the map."""

import csv
import json
import re
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Page, WebSocketRoute, expect

from drone_env.results.record import parse_record
from tests.api.serving import Server
from tests.browser.flights import flown, frames, posted
from tests.browser.stage import (
    at_its_end,
    at_speed,
    counter,
    ended,
    expect_frame,
    fixed,
    fly,
    over,
    pictures,
    pilot,
    points,
    step,
)


def overlapping(page: Page) -> list[str]:
    """Panels beside the map that reach into the next one, and texts that lie over one another in the last of them."""
    return page.locator(".side").evaluate(
        """side => {
            const panels = [...side.querySelectorAll(".panel")];
            const words = [...panels.at(-1).querySelectorAll("*")].filter(
                node => !node.childElementCount && node.textContent && node.checkVisibility());
            const cross = (a, b, from, to) => a[from] < b[to] - 1 && b[from] < a[to] - 1;
            const over = (a, b) => cross(a, b, "left", "right") && cross(a, b, "top", "bottom");
            const bounds = words.map(node => node.getBoundingClientRect());
            return [
                ...panels.filter(panel => panel.scrollHeight > panel.clientHeight + 1).map(panel => panel.className),
                ...words.filter((_, i) => bounds.some((other, j) => j > i && over(bounds[i], other)))
                    .map(node => node.textContent.slice(0, 40)),
            ];
        }"""
    )


def test_it_waits_for_start_shows_each_step_as_the_server_has_it_and_saves_them(page: Page, server: Server) -> None:
    record = flown("medium", 7, "greedy")
    flight = frames(server, record)
    over(page, 7, "/?task=medium&seed=7&pilot=greedy")
    expect_frame(page, flight[0], 100)
    for frame in flight[1:4]:
        step(page)
        expect_frame(page, frame, 100)
        expect(page.locator("#move-detail")).to_contain_text(frame["message"])
    assert overlapping(page) == []
    page.get_by_text("Raw telemetry").click()
    shown = page.locator("#raw-frame")
    expect(shown).not_to_be_empty()
    raw = json.loads(shown.inner_text())
    known = {name: value for name, value in flight[3].items() if name not in ("value", "regret")}
    assert {name: raw[name] for name in known} == known
    assert page.locator("#telemetry").inner_text().split() == [fixed(number, 4) for number in flight[3]["telemetry"]]
    assert overlapping(page) == []
    with page.expect_download() as table:
        page.get_by_role("button", name="CSV", exact=True).click()
    with table.value.path().open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["step"], row["action"], row["reward"], row["x"], row["message"]) for row in rows[1:]] == [
        tuple(str(frame[name]) for name in ("step", "action", "reward", "x", "message")) for frame in flight[1:4]
    ]
    assert {(row["pilot"], row["task"], row["seed"]) for row in rows} == {("greedy", "medium_delivery", "7")}
    with page.expect_download() as picture:
        page.get_by_role("button", name="PNG", exact=True).click()
    assert picture.value.path().read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    # There is no record before the end.
    expect(page.get_by_role("button", name="Record", exact=True)).to_be_disabled()
    fly(page, "Go on")
    ended(page)
    with page.expect_download() as saved:
        page.get_by_role("button", name="Record", exact=True).click()
    assert parse_record(saved.value.path().read_bytes(), "it").actions == record.actions


@pytest.mark.feature("D1")
def test_start_pause_a_step_go_on_the_end_play_it_again_reset_and_a_new_map(page: Page, server: Server) -> None:
    flight = frames(server, flown("easy", 6, "greedy"))
    with page.expect_websocket() as socket:
        page.goto("/?task=easy&seed=6&pilot=greedy")
    at_speed(page, "2")  # slow enough that it does not end before it is paused
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.get_by_role("button", name="Step", exact=True)).to_be_disabled()
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step ([2-9]|[1-9][0-9]) of 60"))
    with socket.value.expect_event("framereceived", says_paused):
        page.get_by_role("button", name="Pause", exact=True).click()
    expect(page.get_by_role("button", name="Go on", exact=True)).to_be_visible()
    # The server flies nothing after it has said that it paused: the next step is the one that is asked for.
    at = counter(page)
    assert at < len(flight) - 1
    step(page)
    expect_frame(page, flight[at + 1], 60)
    fly(page, "Go on")
    ended(page)
    expect_frame(page, flight[-1], 60)
    # What has ended is played again, from any step.
    last = len(flight) - 1
    for key, at in (("Home", 0), (".", 1), ("ArrowRight", 2), ("ArrowLeft", 1), ("End", last), ("ArrowLeft", last - 1)):
        page.keyboard.press(key)
        expect_frame(page, flight[at], 60)
    # The keys go on to work after a click on a button that can do no more, and has the focus.
    for name, at, key, then in (("First step", 0, "ArrowRight", 1), ("Last step", last, "ArrowLeft", last - 1)):
        page.get_by_role("button", name=name).click()
        expect_frame(page, flight[at], 60)
        page.keyboard.press(key)
        expect_frame(page, flight[then], 60)
    page.get_by_role("button", name="Step back").click()
    expect_frame(page, flight[last - 2], 60)
    page.locator("#step-counter").click()
    page.keyboard.press("Space")
    expect_frame(page, flight[-1], 60)
    page.get_by_role("button", name="Reset", exact=True).click()
    expect_frame(page, flight[0], 60)
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_visible()
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value("6")
    page.get_by_role("button", name="New map").click()
    expect(page.get_by_role("spinbutton", name="Map")).not_to_have_value(re.compile("^6?$"))
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")


def says_paused(frame: str | bytes) -> bool:
    message = json.loads(frame)
    return message["type"] == "playing" and not message["playing"]


@pytest.mark.feature("D1")
def test_the_network_shows_what_it_thinks_of_each_move(page: Page, server: Server) -> None:
    flight = frames(server, flown("hard", 7, "pathqnet"))
    over(page, 7, "/?task=hard&seed=7&pilot=pathqnet")
    expect_frame(page, flight[0], 160)
    thoughts = page.get_by_role("table", name="Each move from here")
    for frame in flight[:2]:
        expect_frame(page, frame, 160)
        ranked = sorted(frame["q_values"].items(), key=lambda pair: -pair[1])
        for action, value in ranked:
            row = thoughts.get_by_role("row").filter(has_text=action)
            expect(row.get_by_role("cell").first).to_have_text(fixed(value, 3))
        lead = fixed(ranked[0][1] - ranked[1][1], 3)
        expect(page.locator("#confidence")).to_have_text(
            f"The network's {ranked[0][0]} leads {ranked[1][0]} by {lead}."
        )
        expect(thoughts.locator("tr:has(td.best)")).to_have_count(1)
        expect(thoughts.locator("tr:has(td.best)")).to_contain_text(ranked[0][0])
        city, _, with_arrows = pictures(page)
        page.keyboard.press("q")
        expect(page.get_by_role("checkbox", name="What the network thinks")).not_to_be_checked()
        same, _, without = pictures(page)
        assert same == city
        assert without != with_arrows
        page.get_by_role("checkbox", name="What the network thinks").check()
        if frame is flight[0]:
            step(page)
    assert flight[1]["action"] == max(flight[0]["q_values"], key=flight[0]["q_values"].get)


def test_the_graph_shows_what_was_possible_and_leads_to_each_moment(page: Page, server: Server) -> None:
    # Chance delivers on this map, but late: it gives something away.
    record = flown("easy", 82, "random")
    flight = frames(server, record)
    annotation = posted(server, "annotate", record)
    moves: list[dict[str, Any]] = annotation["moves"]
    last = len(flight) - 1
    at_its_end(page, 82, "/?task=easy&seed=82&pilot=random")
    buttons = page.get_by_role("list", name="Moves").get_by_role("button")
    expect(buttons).to_have_count(last)
    for label, count in annotation["counts"].items():
        expect(page.get_by_role("list", name="Moves").locator(f"button[data-label={label}]")).to_have_count(count)
    slider = page.get_by_role("slider", name="Step of the flight")
    bounds = slider.bounding_box()
    assert bounds is not None
    worst = max(moves, key=lambda move: move["regret"])["step"]
    for at in (worst, 3, last - 2):
        page.mouse.click(bounds["x"] + bounds["width"] * at / last, bounds["y"] + bounds["height"] / 2)
        expect_frame(page, flight[at], 60)
        possible = flight[-1]["score"] if at == last else moves[at]["value"]
        expect(page.locator("#possible")).to_have_text(points(possible))
        expect(page.locator("#lost")).to_have_text(points(annotation["optimal_score"] - possible))
        move = moves[at - 1]
        gave = "" if move["label"] == "best" else f" {move['label']}: lost {points(move['regret'])}."
        said = f"Step {at}: {flight[at]['message']}{gave} {points(possible)} still possible."
        expect(slider).to_have_attribute("aria-valuetext", said)
    # The keys of the page go on to work after a click on a move, which has the focus.
    buttons.nth(worst - 1).click()
    expect_frame(page, flight[worst], 60)
    expect(buttons.nth(worst - 1)).to_have_attribute("aria-current", "step")
    lost = f"Lost {points(moves[worst - 1]['regret'], 2)}: best was {' or '.join(moves[worst - 1]['best_actions'])}."
    expect(page.locator("#move-detail")).to_contain_text(lost)
    page.get_by_text("Raw telemetry").click()
    assert overlapping(page) == []
    page.keyboard.press("ArrowRight")
    expect_frame(page, flight[worst + 1], 60)
    slider.focus()
    for key, at in (("End", last), ("ArrowLeft", last - 1), ("Home", 0)):
        page.keyboard.press(key)
        expect_frame(page, flight[at], 60)
    pictures(page)  # drawn by now
    faults = {move["step"] for move in moves if move["label"] not in ("best", "good")}
    assert colours_of_the_graph(page, "--bad", "--warn", "--accent") & set(range(1, last)) == faults - {last}
    assert colours_of_the_graph(page, "--map-box") == {last}, "where the parcel is delivered"


def colours_of_the_graph(page: Page, *names: str) -> set[int]:
    """The steps at which the graph has one of these colours of the style sheet."""
    found = page.locator(".timeline-graph").evaluate(
        """(canvas, names) => {
            const rgb = name => {
                const probe = document.body.appendChild(document.createElement("i"));
                probe.style.color = `var(${name})`;
                const found = getComputedStyle(probe).color.match(/[0-9]+/g).slice(0, 3).join();
                probe.remove();
                return found;
            };
            const wanted = new Set(names.map(rgb));
            const { width, height } = canvas;
            const copy = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
            copy.drawImage(canvas, 0, 0);
            const steps = Number(document.querySelector("#timeline").max);
            return Array.from({ length: steps + 1 }, (_, step) => {
                const { data } = copy.getImageData(Math.round(2 + step / steps * (width - 4)), 0, 1, height);
                const seen = Array.from({ length: height }, (_, i) => data.slice(4 * i, 4 * i + 3).join());
                return seen.some(one => wanted.has(one));
            });
        }""",
        list(names),
    )
    return {at for at, there in enumerate(found) if there}


def test_a_map_that_is_typed_is_flown_and_its_legend_shows_what_can_be_met_on_it(page: Page, server: Server) -> None:
    over(page, 3, "/?task=easy&seed=3&pilot=optimal")
    number = page.get_by_role("spinbutton", name="Map")
    expect(number).to_have_value("3")
    number.fill("7")
    number.press("Enter")
    expect(page.locator("#boards canvas[role=img]")).to_have_attribute(
        "aria-label", re.compile("^City map of Easy, 10 by 10 cells, map 7, 1 parcel")
    )
    fly(page)
    ended(page)
    expect_frame(page, frames(server, flown("easy", 7, "optimal"))[-1], 60)
    legend = page.get_by_role("list", name="Legend").get_by_role("listitem")
    expect(legend.filter(has_text="Parcel").first).to_be_visible()
    expect(legend.filter(has_text="Pad")).to_be_hidden()
    expect(page.locator("#below")).to_be_hidden()
    page.get_by_role("radio", name="Skyline Easy").check()
    expect(legend.filter(has_text="Pad")).to_be_visible()
    expect(page.locator("#below")).to_have_text("Road")
    expect(page.get_by_text("a battery of")).to_be_visible()
    # The first map on whose best flight the drone comes to a pad.
    flights = ((seed, frames(server, flown("skyline_easy", seed, "optimal"))) for seed in range(100))
    seed, flight = next((seed, all_) for seed, all_ in flights if any(frame["cell_below"] == "pad" for frame in all_))
    number.fill(str(seed))
    number.press("Enter")
    at = next(frame["step"] for frame in flight if frame["cell_below"] == "pad")
    for frame in flight[:at]:
        expect(page.locator("#step-counter")).to_have_text(re.compile(f"^Step {frame['step']} of"))
        expect(page.locator("#below")).to_have_text(frame["cell_below"].title())
        step(page)
    expect(page.locator("#below")).to_have_text("Pad: WAIT charges")


def test_the_answer_to_an_older_choice_does_not_undo_a_newer_one(beside: Callable[[str], Page]) -> None:
    page, held = beside(""), list[Callable[[], None]]()

    def hold_the_flights(socket: WebSocketRoute) -> None:
        server = socket.connect_to_server()

        def answer(text: str | bytes) -> None:
            if json.loads(text)["type"] == "flights":
                held.append(lambda: socket.send(text))
            else:
                socket.send(text)

        server.on_message(answer)

    def wait_for_one() -> None:
        while not held:
            page.wait_for_timeout(20)

    page.route_web_socket("**/live", hold_the_flights)
    page.goto("/?task=easy&seed=3&pilot=greedy")
    you, number = pilot(page, "You"), page.get_by_role("spinbutton", name="Map")
    wait_for_one()
    you.click()
    number.fill("7")
    number.press("Enter")
    for _ in range(2):
        held.pop(0)()
        wait_for_one()
        expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
        expect(you).to_have_attribute("aria-pressed", "true")
        expect(number).to_have_value("7")
    held.pop(0)()
    page.get_by_role("group", name="Fly").get_by_role("button", name="Wait", exact=True).click()
    expect(page.locator("#step-counter")).to_have_text(re.compile("^Step 1 of 60"))
