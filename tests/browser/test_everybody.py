"""For everybody: dark and light, keyboards, screen readers, less motion."""

import re
from collections.abc import Callable
from typing import Literal

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from tests.browser.shown import changed, counter, expect_flying, expect_step, pictures
from tests.browser.stage import FASTEST, at_its_end, at_speed, choices, ended, fly, over, press, show, standings


def findings(page: Page, part: str = "html") -> list[str]:
    """What axe finds serious or critical; a line each."""
    # One line of a log or a table is enough: all are alike, and axe takes its time for each.
    page.evaluate(
        "part => part.querySelectorAll('.log li ~ li, tbody tr ~ tr').forEach(line => line.remove())",
        page.locator(part).element_handle(),
    )
    # Preloading would inject the style sheets into the page, which the page does not allow; selectors take long.
    options = {"preload": False, "resultTypes": ["violations"], "selectors": False}
    answer = page.evaluate("options => axe.run(...options)", [part, options])
    assert answer["passes"], "axe has looked at nothing"
    return [
        f"{violation['id']}: {node['html'][:120]} ({node['failureSummary']})"
        for violation in answer["violations"]
        if violation["impact"] in ("serious", "critical")
        for node in violation["nodes"]
    ]


@pytest.mark.long
@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_axe_finds_nothing_serious_in_any_view(beside: Callable[..., Page], scheme: Literal["dark", "light"]) -> None:
    page = beside()  # which loses lines of its tables
    page.emulate_media(color_scheme=scheme)
    page.goto("/")
    expect(page.locator("html")).to_have_attribute("data-theme", scheme)
    page.evaluate(Axe().axe_script)
    expect_step(page, 0, 100)
    found = findings(page, "#hello")
    show(page, "/?task=easy&seed=7&pilots=human,random")
    expect_flying(page, "Random", "You")
    expect_step(page, 0, 60)
    page.keyboard.press("ArrowRight")
    expect_step(page, 1, 60)
    choices(page)
    found += findings(page)
    page.keyboard.press("Escape")
    expect(page.locator(".plan-choices")).to_be_hidden()
    page.keyboard.press("?")
    expect(page.locator("#help")).to_be_visible()
    found += findings(page, "#help")
    page.keyboard.press("Escape")
    over(page, 7, "/?task=easy&seed=7&pilot=pathqnet")
    fly(page)
    expect(ended(page)).to_have_class(re.compile("over"))
    expect(page.get_by_role("button", name=re.compile("^Step 1, "))).to_be_visible()
    found += findings(page, "#view-fly")
    for query, part, sign in (
        ("compare&task=easy&pilots=greedy,random", "#view-compare", "dl.paired"),
        ("compare&task=easy&pilot=random", "#view-compare", ".losses"),
        ("learn", "#view-learn", ".lesson"),
        ("api", "#view-api", "#log-requests li"),
        ("draw&task=easy&seed=7", "#view-draw", "#drawing"),
    ):
        show(page, f"/?view={query}")
        expect(page.locator(sign).first).to_be_visible()
        found += findings(page, part)
    assert found == []


def test_the_colours_are_switched_and_remembered(page: Page) -> None:
    show(page, "/?task=easy&seed=8&pilot=pathqnet")
    ground = "getComputedStyle(document.documentElement).backgroundColor"
    expect_step(page, 0, 60)
    dark, before = page.evaluate(ground), pictures(page)
    press(page, "Switch to light colours")
    assert page.evaluate(ground) != dark
    assert 0 in changed(page, before)
    # The choice of the visitor outlasts that of the system.
    page.reload()
    press(page, "Switch to dark colours")
    page.emulate_media(color_scheme="light")
    pictures(page)
    assert page.evaluate(ground) == dark
    page.emulate_media(color_scheme="dark")


def test_everything_goes_with_the_keyboard_alone(page: Page) -> None:
    page.goto("/?task=easy&seed=7&pilot=pathqnet")
    speed, focused = page.get_by_role("combobox", name="Speed"), page.locator(":focus")
    expect_step(page, 0, 60)
    page.keyboard.press("Tab")
    expect(focused).to_have_text("Skip to the flight")
    page.keyboard.press("Enter")
    names: list[str] = []
    while names[-1:] != ["Start"]:
        assert len(names) < 40, names
        page.keyboard.press("Tab")
        names.append(focused.evaluate("e => e.getAttribute('aria-label') || e.innerText.trim() || e.id"))
        if names[-1].startswith("Easy · "):
            page.keyboard.press("Enter")  # opens the choices
    assert {"Easy", "Map of the day", "Specifications", "Greedy", "Add Greedy", "New map", "Zoom in"} <= {*names}
    speed.focus()
    page.keyboard.press("End")
    expect(speed).to_have_value(FASTEST)
    page.locator("#start").press("Enter")
    ended(page).get_by_role("button", name="Next: Medium").focus()
    page.keyboard.press("Enter")
    expect_step(page, 0, 100)
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_focused()


def test_the_focus_comes_back_from_a_dialog_and_goes_to_a_fork(page: Page) -> None:
    show(page, "/?task=easy&seed=9&pilot=human")
    expect_flying(page, "You")
    expect_step(page, 0, 60)
    page.keyboard.press("ArrowRight")
    expect_step(page, 1, 60)
    another, dialog = page.get_by_role("button", name="New map"), page.get_by_role("dialog")
    another.press("Enter")
    # The button that loses nothing has the focus.
    expect(dialog.get_by_role("button", name="Keep flying")).to_be_focused()
    page.keyboard.press("Escape")
    expect(another).to_be_focused()
    expect_step(page, 1, 60)
    # The key after "Try from step" is for the drone, not for the button, which stays until the fork is there.
    at_its_end(page, 7, "/?task=hard&seed=7&pilot=greedy").get_by_role("button", name="Try from step").focus()
    page.keyboard.press("Enter")
    page.keyboard.press("Space")
    expect(page.locator("#step-counter")).to_contain_text("WAIT")
    expect(standings(page)).to_have_count(2)


@pytest.mark.long
def test_less_motion_stands_still_between_steps(page: Page) -> None:
    show(page, "/?task=hard&seed=7&pilot=greedy")
    expect_step(page, 0, 160)
    at_speed(page, "0.5")
    press(page, "Start")
    for motion in ("reduce", "no-preference"):
        page.emulate_media(reduced_motion=motion)
        # The map looks at the setting when something changes. Then there are two seconds until the next step.
        at = counter(page)
        expect(page.locator("#step-counter")).not_to_have_text(re.compile(rf"^Step {at}\b"))
        before = pictures(page)
        page.wait_for_timeout(500)
        assert (changed(page, before) == []) == (motion == "reduce")
    page.emulate_media(reduced_motion="reduce")
    press(page, "Pause")
