"""Several flights over one map: pilots, each in its colour, and forks, which leave a flight for another move."""

from collections import Counter
from collections.abc import Callable

import pytest
from playwright.sync_api import Locator, Page, expect

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.flights.record import record_of
from drone_env.results.analysis import analyse_flight
from tests.api.serving import Server
from tests.browser.flights import fill, flown, get, posted
from tests.browser.shown import expect_step, lost, painted, points
from tests.browser.stage import ended, fly, keys, over, pilot, press, show, slider, standings, until

SEED = 20
"""A map on which chance, too, delivers, after twelve steps."""
NAMES = {"random": "Random", "pathqnet": "PathQNet", "greedy": "Greedy", "optimal": "Optimal"}


def test_four_keep_their_colours_are_ranked_while_they_fly_and_each_is_annotated(page: Page, server: Server) -> None:
    annotations = {agent: posted(server, "annotate", flown("easy", SEED, agent)) for agent in NAMES}
    values = {
        NAMES[agent]: [*(move["value"] for move in annotation["moves"]), annotation["score"]]
        for agent, annotation in annotations.items()
    }
    best = values["Optimal"][0]
    colours = {one["id"]: f"--pilot-{one['colour']}" for one in get(server, "pilots")["pilots"]}
    boards = page.get_by_role("img", name="City map")

    def expect_ranked(at: int) -> None:
        """The best pilot is first at the end; during the flight, possible deliveries do not count."""
        now = {name: value[min(at, len(value) - 1)] for name, value in values.items()}
        best_first = sorted(now, key=now.__getitem__, reverse=True)
        expect(names).to_have_text(best_first if at >= len(values["Random"]) - 1 else list(NAMES.values()))
        row = standings(page).filter(has_text="Random").get_by_role("cell")
        # The standings tell possible scores from final ones.
        flies = "up to " if at < len(values["Random"]) - 1 else ""
        expect(row.nth(2)).to_have_text(f"{flies}{points(now['Random'])}")
        expect(row.last).to_have_text(lost(best, now["Random"]))

    def expect_place() -> None:
        final = {name: value[-1] for name, value in values.items()}
        order = sorted(final, key=final.__getitem__, reverse=True)
        told = ", ".join(f"{name} {points(final[name])}" for name in order)
        place = f"At the end, place 1 of 4: {told}. The higher score wins."
        expect(page.locator("#standings-note")).to_have_text(place)
        expect(page.locator(".results")).to_contain_text(place)

    names = standings(page).get_by_role("rowheader")
    over(page, SEED, f"/?task=easy&seed={SEED}&pilots={','.join(NAMES)}")
    expect(names).to_have_text(list(NAMES.values()))
    press(page, "Step")
    expect_ranked(1)
    fly(page, "Resume")
    page.keyboard.press("4")
    expect_place()
    expect_ranked(60)
    page.keyboard.press("Home")
    expect_ranked(0)
    expect_place()
    page.keyboard.press("End")
    for number, (agent, name) in enumerate(NAMES.items(), 1):
        page.keyboard.press(str(number))
        expect(standings(page).and_(page.locator(".selected"))).to_contain_text(name)
        for label, count in Counter(move["label"] for move in annotations[agent]["moves"]).items():
            expect(page.locator(f"#moves button[data-label={label}]")).to_have_count(count)
    # Alone, too, a pilot keeps its colour: brackets in it surround the target.
    pilot(page, "Random").click()
    expect(page.locator("#standings")).to_be_hidden()
    page.keyboard.press("q")  # hides the arrows of the network, which have the colour of its pilot
    until(page, lambda: painted(boards, *colours.values()) == [colours["random"]])
    expect(page.locator(".pilot", has_text="Random")).to_have_attribute("style", f"--lane: var({colours['random']});")
    page.keyboard.press("q")


KEYS = {"UP": "ArrowUp", "DOWN": "ArrowDown", "LEFT": "ArrowLeft", "RIGHT": "ArrowRight", "WAIT": " "}


def standing(page: Page, name: str) -> Locator:
    """The cells of a flight in the standings."""
    row = standings(page).filter(has=page.get_by_role("button", name=name, exact=True))
    return row.get_by_role("cell")


def test_a_fork_has_its_values_and_link(page: Page, beside: Callable[..., Page], server: Server) -> None:
    of, other = flown("hard", 7, "pathqnet").actions[:20], ["WAIT", "LEFT", "UP"]
    flight = Episode("hard", "tiered", 7).fly(Action[name] for name in (*of, *other))
    values = analyse_flight(record_of(flight, "human")).values
    show(page, "/?task=hard&seed=7&pilot=pathqnet&step=20")
    expect_step(page, 20, 160)
    press(page, "Play WAIT")
    for at, action in enumerate(other, 21):
        expect_step(page, at, 160, action)
        expect(standing(page, "You from step 20")).to_have_text(
            [str(at), "3/5", f"up to {points(values[at])}", lost(values[0], values[at])]
        )
        # The flight that it left flies along.
        expect(standing(page, "PathQNet").first).to_have_text(str(at))
        if at < 23:
            page.keyboard.press(KEYS[other[at - 20]])
    before = "".join(action[0] for action in of)
    link = f"{server.url}/?task=hard&seed=7&pilots=pathqnet,human&profile=tiered&fork=20&of=pathqnet&actions={before}"
    expect(page).to_have_url(f"{link}WLU")
    shown = standings(page).all_inner_texts()
    tab = beside(f"{link}WLU")
    expect_step(tab, 23, 160, "UP")
    expect(standings(tab)).to_have_text([text.strip() for text in shown], use_inner_text=True)
    # The visitor can take back the moves of the fork, but not those before it.
    for left in (22, 21, 20):
        press(page, "Undo")
        expect_step(page, left, 160)
    expect(page.get_by_role("button", name="Undo", exact=True)).to_be_disabled()
    # The flight that it left stays where it is.
    expect(page).to_have_url(f"{link}&ended=23")
    page.reload()
    expect(standing(page, "PathQNet").first).to_have_text("23")


@pytest.mark.long
def test_the_link_to_a_race_that_is_over_shows_all_flights_to_their_ends(
    page: Page, beside: Callable[..., Page], server: Server
) -> None:
    best = flown("easy", 64, "optimal").actions
    page.evaluate("localStorage['drone-env-name'] = 'Ada'")
    over(page, 64, "/?task=easy&seed=64&pilots=human,random")
    expect_step(page, 0, 60)
    keys(page, *(KEYS[action] for action in best))
    # Chance flies longer than the person, and goes on by itself.
    ended(page)
    last = len(flown("easy", 64, "random").actions)
    assert last > len(best)
    letters = "".join(action[0] for action in best)
    link = f"{server.url}/?task=easy&seed=64&pilots=human,random&of=human~Ada&actions={letters}&ended={last}"
    expect(page).to_have_url(link)
    page.reload()
    expect(page.locator("#results-title")).to_have_text("You: All parcels delivered.")
    # To others it is Ada's.
    page.evaluate("localStorage['drone-env-name'] = 'Bob'; delete localStorage['drone-env-best']")
    page.evaluate("delete localStorage['drone-env-flown']")
    tab = beside(link)
    expect(tab.locator("#results-title")).to_have_text("Ada: All parcels delivered.")
    expect_step(tab, len(best), len(best))
    expect(slider(tab)).to_have_value(str(last))
    expect(tab.get_by_text("Easy · map 64 · Ada, Random")).to_be_visible()
    shown = [text.strip().replace("You", "Ada") for text in standings(page).all_inner_texts()]
    expect(standings(tab)).to_have_text(shown, use_inner_text=True)
    expect(tab).to_have_url(link)
    ended(tab)
    # The flight is not credited to the visitor who opens the link.
    assert {row["agent"] for row in get(server, "episodes", task="easy", seed=64)["episodes"]} == {
        "human (Ada)",
        "random",
    }
    assert tab.evaluate("localStorage['drone-env-best']") is None


def test_a_stored_flight_is_left_by_key_and_its_link_comes_back(page: Page, server: Server) -> None:
    record = flown("medium", 9, "random", label="me")
    (id_,) = fill(server.data, [record])
    over(page, 9, f"/?episode={id_}&step=6")
    expect_step(page, 6, 100)
    page.keyboard.press("f")
    expect(standing(page, "You from step 6").first).to_be_visible()
    other = next(action for action in KEYS if action != record.actions[6])
    page.keyboard.press(KEYS[other])
    expect_step(page, 7, 100, other)
    flight = "".join(action[0] for action in (*record.actions[:6], other))
    link = f"{server.url}/?episode={id_}&task=medium&seed=9&pilot=human&profile=tiered&fork=6&of=me&actions={flight}"
    expect(page).to_have_url(link)
    page.reload()
    expect_step(page, 7, 100, other)
    expect(page).to_have_url(link)
