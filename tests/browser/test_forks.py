"""Forks: another move from any step of any flight, what it loses, beside the flight that it left."""

from collections.abc import Callable

from playwright.sync_api import Locator, Page, expect

from drone_env.core.actions import Action
from drone_env.results.analysis import analyse_flight
from drone_env.results.record import record_of
from tests.api.serving import Server
from tests.browser.flights import by_hand, fill, flown, frames
from tests.browser.shown import changed, expect_frame, expect_step, painted, pictures, points
from tests.browser.stage import over, press, show, slider, standings

KEYS = {"UP": "ArrowUp", "DOWN": "ArrowDown", "LEFT": "ArrowLeft", "RIGHT": "ArrowRight", "WAIT": " "}


def standing(page: Page, name: str) -> Locator:
    """The cells of a flight in the standings."""
    row = standings(page).filter(has=page.get_by_role("button", name=name, exact=True))
    return row.get_by_role("cell")


def letters(actions: list[str]) -> str:
    return "".join(action[0] for action in actions)


def test_a_fork_has_the_values_of_its_analysis_and_a_link_of_its_own(
    page: Page, beside: Callable[..., Page], server: Server
) -> None:
    of, other = flown("hard", 7, "pathqnet").actions[:20], ["WAIT", "LEFT", "UP"]
    values = analyse_flight(record_of(by_hand("hard", 7, (Action[name] for name in (*of, *other))), "human")).values
    show(page, "/?task=hard&seed=7&pilot=pathqnet&step=20")
    expect_step(page, 20, 160)
    press(page, "Play WAIT")
    expect_step(page, 21, 160, "WAIT")
    # The flight that it left flies along, on the map and in the graph.
    expect(standing(page, "PathQNet").first).to_have_text("21")
    graph, colours = page.locator(".timeline-graph"), ("--pilot-3", "--pilot-9")
    assert painted(graph, *colours) == ["--pilot-9"]
    in_front = pictures(page)
    page.keyboard.press("1")
    expect(page.locator("#lost")).to_have_text(standing(page, "PathQNet").last.inner_text())
    assert painted(graph, *colours) == ["--pilot-3"]
    assert changed(page, in_front) == [2]
    page.keyboard.press("2")
    for at, action in enumerate(other[1:], 21):
        lost = points(values[0] - values[at])
        expect(standing(page, "You from step 20")).to_have_text([str(at), "3/5", points(values[at]), lost])
        possible = page.locator(f"#q-values tr[data-action={action}]").get_by_role("cell").nth(1)
        expect(possible).to_have_text(points(values[at + 1]))
        page.keyboard.press(KEYS[action])
        expect_step(page, at + 1, 160, action)
    link = (
        f"{server.url}/?task=hard&seed=7&pilots=pathqnet,human&profile=tiered&fork=20&of=pathqnet"
        f"&actions={letters([*of, *other])}"
    )
    expect(page).to_have_url(link)
    shown = standings(page).all_inner_texts()
    tab = beside(link)
    expect_step(tab, 23, 160, "UP")
    expect(standings(tab)).to_have_text([text.strip() for text in shown], use_inner_text=True)
    # The visitor can take back the moves of the fork, but not those before it.
    for left in (22, 21, 20):
        press(page, "Undo")
        expect_step(page, left, 160)
    expect(page.get_by_role("button", name="Undo", exact=True)).to_be_disabled()
    expect(page).to_have_url(link.replace(letters(other), ""))


def test_a_stored_flight_is_left_by_key_and_its_link_comes_back(page: Page, server: Server) -> None:
    record = flown("medium", 9, "random", label="me")
    id_, flight = fill(server.data, [record])[0], frames(server, record)
    over(page, 9, f"/?episode={id_}&step=6")
    expect_frame(page, flight[6], 100)
    page.keyboard.press("f")
    expect(standing(page, "You from step 6").first).to_be_visible()
    other = next(action for action in KEYS if action != record.actions[6])
    page.keyboard.press(KEYS[other])
    expect_step(page, 7, 100, other)
    link = (
        f"{server.url}/?episode={id_}&task=medium&seed=9&pilot=human&profile=tiered&fork=6&of=me"
        f"&actions={letters([*record.actions[:6], other])}"
    )
    expect(page).to_have_url(link)
    # The flight that was left can be seen to its end; the fork is as long as it was flown.
    expect(slider(page)).to_have_attribute("max", str(len(record.actions)))
    press(page, "Step")
    expect(standing(page, "me").first).to_have_text("8")
    expect(standing(page, "You from step 6").first).to_have_text("7")
    press(page, "Last step")
    expect(page).to_have_url(link)
    page.reload()
    expect_step(page, 7, 100, other)
    expect(page).to_have_url(link)
    page.go_back()
    expect(page.locator("#standings")).to_be_hidden()
    expect_frame(page, flight[6], 100)
    # No fork leaves from the end of a flight.
    page.keyboard.press("End")
    expect(page.locator("#fork")).to_be_disabled()
