"""Forks: another move from any step of any flight, what it gives away, beside the flight that it left."""

import json
import re
from collections.abc import Callable
from typing import Any

from playwright.sync_api import Locator, Page, expect

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.models import DIRECTIONS
from drone_env.results.analysis import analyse_flight
from drone_env.results.record import record_of
from tests.api.serving import Server
from tests.browser.flights import fill, flown, frames
from tests.browser.shown import expect_frame, painted, pictures, points
from tests.browser.stage import at_its_end, over, show, step

KEYS = {"UP": "ArrowUp", "DOWN": "ArrowDown", "LEFT": "ArrowLeft", "RIGHT": "ArrowRight", "WAIT": " "}


def standing(page: Page, name: str) -> Locator:
    """The row of a flight in the standings."""
    rows = page.locator("#standings tbody tr")
    return rows.filter(has=page.get_by_role("button", name=name, exact=True))


def move(page: Page, action: str) -> Locator:
    """The row of a move in the table of those that are possible from here."""
    return page.locator(f"#q-values tr[data-action={action}]")


def play(page: Page, action: str) -> None:
    page.get_by_role("button", name=f"Play {action}", exact=True).click()


def letters(actions: list[str]) -> str:
    return "".join(action[0] for action in actions)


def raw(page: Page, step: int) -> dict[str, Any]:
    """The frame of a step, once it is shown, as the page has it: every digit of it."""
    shown = page.locator("#raw-frame")
    expect(shown).to_contain_text(re.compile(rf'^\{{\s*"step": {step},'))
    return json.loads(shown.text_content() or "")


def test_a_fork_from_step_20_of_hard_map_7_has_the_values_of_its_analysis_to_the_last_bit(
    page: Page, beside: Callable[[str], Page], server: Server
) -> None:
    episode, other = Episode("hard", "tiered", 7), ["WAIT", "LEFT", "UP"]
    of = flown("hard", 7, "pathqnet").actions[:20]
    for action in (*of, *other):
        episode.step(Action[action])
    values = analyse_flight(record_of(episode, "human")).values
    show(page, "/?task=hard&seed=7&pilot=pathqnet&step=20")
    where = page.locator("#step-counter")
    expect(where).to_have_text(re.compile("^Step 20 of 160"))
    play(page, other[0])
    expect(where).to_have_text(re.compile("^Step 21 of 160 · WAIT"))
    # It lies beside the flight that it left, which flies along, on the map and in the graph.
    expect(page.locator("#standings .standing-name")).to_have_count(2)
    expect(standing(page, "PathQNet").get_by_role("cell").first).to_have_text("21")
    graph, colours = page.locator(".timeline-graph"), ("--pilot-3", "--pilot-9")
    assert painted(graph, *colours) == ["--pilot-9"]
    in_front = pictures(page)
    page.keyboard.press("1")
    expect(page.locator("#lost")).to_have_text(standing(page, "PathQNet").get_by_role("cell").last.inner_text())
    assert painted(graph, *colours) == ["--pilot-3"]
    assert [now == then for now, then in zip(pictures(page), in_front, strict=True)] == [True, True, False]
    page.keyboard.press("2")
    # What it gave away stands there, and what each further move would.
    for at, action in enumerate(other[1:], 21):
        fork = standing(page, "You from step 20").get_by_role("cell")
        expect(fork).to_have_text([str(at), "3/5", points(values[at]), points(values[0] - values[at])])
        cells = move(page, action).get_by_role("cell")
        expect(cells.nth(1)).to_have_text(points(values[at + 1]))
        page.keyboard.press(KEYS[action])
        expect(where).to_have_text(re.compile(f"^Step {at + 1} of 160 · {action}"))
    page.locator("details.telemetry").evaluate("one => { one.open = true; }")  # another test may have opened it
    for at in range(23, 17, -1):
        expect(where).to_have_text(re.compile(f"^Step {at} of 160"))
        frame = raw(page, at)
        assert (frame["step"], frame["value"], frame["regret"]) == (at, values[at], values[0] - values[at])
        page.get_by_role("button", name="Step back").click()
    page.get_by_role("button", name="Last step").click()
    link = (
        f"{server.url}/?task=hard&seed=7&pilots=pathqnet,human&profile=tiered&fork=20&of=pathqnet"
        f"&actions={letters([*of, *other])}"
    )
    expect(page).to_have_url(link)
    shown = page.locator("#standings tbody tr").all_inner_texts()
    tab = beside(link)
    expect(tab.locator("#step-counter")).to_have_text(re.compile("^Step 23 of 160 · UP"))
    expect(tab.locator("#standings tbody tr")).to_have_text([text.strip() for text in shown], use_inner_text=True)
    expect(move(tab, "UP").get_by_role("cell").nth(1)).not_to_have_text("–")
    # Moves are taken back, but not those of another.
    undo = page.get_by_role("button", name="Undo", exact=True)
    for left in (22, 21, 20):
        undo.click()
        expect(where).to_have_text(re.compile(f"^Step {left} of 160"))
    expect(undo).to_be_disabled()
    expect(page).to_have_url(link.replace(letters(other), ""))


def test_where_a_flight_went_wrong_another_is_tried_and_kept_as_what_it_is(page: Page, server: Server) -> None:
    record = flown("easy", 20, "random")
    analysis = analyse_flight(record)
    worst = max(analysis.moves, key=lambda one: one.regret)
    at = worst.step - 1
    episode = Episode("easy", "tiered", 20)
    for action in record.actions[:at]:
        episode.step(Action[action])
    strip = at_its_end(page, 20, "/?task=easy&seed=20&pilot=random")
    expect(strip).to_contain_text(f"Worst move: step {worst.step}, {record.actions[at]}, lost {points(worst.regret)}")
    page.get_by_role("button", name="Try from step").click()
    name = f"You from step {at}"
    expect(standing(page, name)).to_be_visible()
    expect(page.locator("#step-counter")).to_have_text(re.compile(f"^Step {at} of 60"))
    while not episode.ended:
        best = analyse_flight(record_of(episode.copy().fly([Action.WAIT]), "x")).moves[-1].best_actions[0]
        episode.step(best)
        page.keyboard.press(KEYS[DIRECTIONS[best]])
        expect(page.locator("#step-counter")).to_have_text(re.compile(f"^Step {episode.steps} of"))
    expect(strip).to_contain_text(f"{name}: All parcels delivered. Score {points(episode.score)}")
    expect(page.locator("#standings-note")).to_have_text(
        f"{name} wins with {points(episode.score)}: all parcels delivered."
    )
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="Copy result").click()
    expect(page.locator("#toasts")).to_contain_text("Result copied.")
    assert f"{name}: {episode.steps}, optimum " in page.evaluate("navigator.clipboard.readText()")
    stored = server.client.get("/episodes", params={"task": "easy"}).json()["episodes"][0]
    assert stored["agent"] == f"human with values from step {at} of random"
    assert stored["score"] == episode.score


def test_a_stored_flight_is_left_by_key_and_its_link_comes_back(page: Page, server: Server) -> None:
    record = flown("medium", 9, "random", label="me")
    id_, flight = fill(server.data, [record])[0], frames(server, record)
    over(page, 9, f"/?episode={id_}&step=6")
    expect_frame(page, flight[6], 100)
    page.keyboard.press("f")
    expect(standing(page, "You from step 6")).to_be_visible()
    other = next(action for action in KEYS if action != record.actions[6])
    page.keyboard.press(KEYS[other])
    where = page.locator("#step-counter")
    expect(where).to_have_text(re.compile(f"^Step 7 of 100 · {other}"))
    link = (
        f"{server.url}/?episode={id_}&task=medium&seed=9&pilot=human&profile=tiered&fork=6&of=me"
        f"&actions={letters([*record.actions[:6], other])}"
    )
    expect(page).to_have_url(link)
    # The flight that was left is there to its end, and is not what a step more is of.
    expect(page.get_by_role("slider", name="Step of the flight")).to_have_attribute("max", str(len(record.actions)))
    step(page)
    expect(standing(page, "me").get_by_role("cell").first).to_have_text("8")
    expect(standing(page, "You from step 6").get_by_role("cell").first).to_have_text("7")
    page.get_by_role("button", name="Last step").click()
    expect(where).to_have_text(re.compile("^Step 7 of 100"))
    page.keyboard.press("Home")
    expect(page).to_have_url(f"{link}&step=0")
    page.reload()
    expect_frame(page, flight[0], 100)
    page.get_by_role("button", name="Last step").click()
    expect(where).to_have_text(re.compile(f"^Step 7 of 100 · {other}"))
    expect(page).to_have_url(link)
    page.reload()
    expect(where).to_have_text(re.compile(f"^Step 7 of 100 · {other}"))
    expect(standing(page, "me").get_by_role("cell").nth(2)).to_have_text(re.compile("[0-9]"))
    expect(page).to_have_url(link)
    page.go_back()
    expect(page.locator("#standings")).to_be_hidden()
    expect_frame(page, flight[6], 100)
    # At its end nothing can be tried.
    page.keyboard.press("End")
    expect(page.locator("#fork")).to_be_disabled()
    page.keyboard.press("f")
    expect(page.locator("#standings")).to_be_hidden()


def test_a_fork_is_left_by_another_once_the_visitor_gives_it_up(page: Page) -> None:
    show(page, "/?task=easy&seed=7&pilot=greedy&step=2")
    where = page.locator("#step-counter")
    expect(where).to_have_text(re.compile("^Step 2 of 60"))
    page.keyboard.press("f")
    expect(standing(page, "You from step 2")).to_be_visible()
    for at in (3, 4, 5):
        page.keyboard.press(" ")
        expect(where).to_have_text(re.compile(f"^Step {at} of 60"))
    page.get_by_role("slider", name="Step of the flight").fill("4")
    play(page, "UP")
    question = page.get_by_role("dialog", name="Give up your flight at step 5?")
    question.get_by_role("button", name="Go on flying").click()
    expect(question).to_be_hidden()
    expect(where).to_have_text(re.compile("^Step 4 of 60 · WAIT"))
    play(page, "UP")
    question.get_by_role("button", name="Give it up").click()
    expect(where).to_have_text(re.compile("^Step 5 of 60 · UP"))
    expect(page.locator("#standings .standing-name")).to_have_text(["Greedy", "You from step 4", "You from step 2"])
