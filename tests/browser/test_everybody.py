"""For everybody: dark and light, narrow screens, keyboards, screen readers, less motion, slow lines."""

import re

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, Response, expect

from tests.browser.stage import FASTEST, fly, pixels, results, view
from tests.browser.tabs import NARROW, Tabs

MISSION = "/?task=easy&seed=7&pilot=pathqnet"
VIEWS = ("Race", "Replay", "History", "Specifications", "Logs")
PAGE_BYTES = 300_000


def findings(page: Page) -> list[str]:
    """What axe holds to be serious or critical in dark, and of the contrasts in light; a line each."""
    violations = page.evaluate("() => axe.run(document, { resultTypes: ['violations'] })")["violations"]
    page.get_by_role("button", name="Switch to light colours").click()
    contrast = {"runOnly": {"type": "rule", "values": ["color-contrast"]}}
    violations += page.evaluate("options => axe.run(document, options)", contrast)["violations"]
    page.get_by_role("button", name="Switch to dark colours").click()
    return [
        f"{violation['id']}: {node['html'][:120]} ({node['failureSummary']})"
        for violation in violations
        if violation["impact"] in ("serious", "critical")
        for node in violation["nodes"]
    ]


def test_axe_finds_nothing_serious_in_any_view_dark_or_light(tabs: Tabs) -> None:
    # Without motion, so that no colour is on its way to another.
    page = tabs.open(MISSION, reduced_motion="reduce")
    page.evaluate(Axe().axe_script)
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    found = findings(page)
    fly(page)
    results(page).get_by_role("button", name="Look at the flight").click()
    expect(page.get_by_role("button", name=re.compile("^Step 1, "))).to_be_visible()
    found += findings(page)
    view(page, "History")
    page.locator("tr[data-episode]").first.click()
    expect(page.locator(".facts").get_by_text("Optimum")).to_be_visible()
    found += findings(page)
    for name in ("Race", "History", "Specifications", "Logs"):
        view(page, name)
        page.wait_for_timeout(250)
        found += findings(page)
    assert found == []


@pytest.mark.parametrize("scheme", ["dark", "light"])
def test_axe_finds_nothing_serious_in_the_results(tabs: Tabs, scheme: str) -> None:
    page = tabs.open(MISSION, color_scheme=scheme)
    expect(page.locator("html")).to_have_attribute("data-theme", scheme)
    fly(page)
    dialog = results(page)
    dialog.get_by_role("checkbox").uncheck()
    expect(dialog.get_by_text("Success rate")).to_be_visible()
    violations = Axe().run(page).response["violations"]
    assert [(one["id"], one["nodes"]) for one in violations if one["impact"] in ("serious", "critical")] == []


def test_the_colours_are_switched_and_remembered(tabs: Tabs) -> None:
    page = tabs.open(MISSION)
    ground = "getComputedStyle(document.documentElement).backgroundColor"
    dark = page.evaluate(ground)
    terrain = page.locator("#maps canvas").first
    expect(terrain).to_be_visible()
    page.wait_for_timeout(200)
    city = pixels(terrain)
    page.get_by_role("button", name="Switch to light colours").click()
    page.wait_for_timeout(200)
    assert page.evaluate(ground) != dark
    assert pixels(terrain) != city
    page.reload()
    expect(page.get_by_role("button", name="Switch to dark colours")).to_be_visible()


def test_a_narrow_screen_never_scrolls_sideways(tabs: Tabs) -> None:
    page = tabs.open(MISSION, viewport=NARROW, has_touch=True, is_mobile=True)
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")

    def too_wide() -> list[str]:
        return page.evaluate(
            """() => document.documentElement.scrollWidth <= innerWidth ? [] :
                [...document.querySelectorAll("body *")].filter(e => e.getBoundingClientRect().right > innerWidth + 1)
                    .map(e => e.tagName + "." + e.className + "#" + e.id)"""
        )

    wide = {"Watch": too_wide()}
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_in_viewport()
    fly(page)
    dialog = results(page)
    dialog.get_by_role("checkbox").uncheck()
    wide["Results"] = too_wide()
    box = dialog.bounding_box()
    assert box is not None
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= 390
    dialog.get_by_role("button", name="Close").click()
    for name in VIEWS:
        view(page, name)
        page.wait_for_timeout(250)
        wide[name] = too_wide()
    page.get_by_role("link", name="History").click()
    page.locator("tr[data-episode]").first.click()
    expect(page.locator(".facts").get_by_text("Optimum")).to_be_visible()
    wide["A replay"] = too_wide()
    assert {view: nodes for view, nodes in wide.items() if nodes} == {}


def test_everything_goes_with_the_keyboard_alone(tabs: Tabs) -> None:
    page = tabs.open(MISSION)
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    focused = page.locator(":focus")
    page.keyboard.press("Tab")
    expect(focused).to_have_text("Skip to the mission")
    page.keyboard.press("Enter")
    names = []
    for _ in range(40):
        page.keyboard.press("Tab")
        names.append(focused.evaluate("e => e.getAttribute('aria-label') || e.innerText.trim() || e.id"))
        outline = focused.evaluate("e => getComputedStyle(e).outlineStyle")
        assert outline != "none" or "segment" in focused.evaluate("e => e.parentElement.className"), names[-1]
        if names[-1] == "Start":
            break
    assert names[-1] == "Start", names
    page.keyboard.press("Enter")
    expect(page.locator("#step-counter")).to_have_text(re.compile("Step [1-9]"))
    page.keyboard.press("Space")
    expect(page.get_by_role("button", name="Go on")).to_be_focused()
    for _ in range(4):
        page.keyboard.press("+")
    expect(page.get_by_role("slider", name="Speed")).to_have_value(FASTEST)
    page.keyboard.press("Space")
    dialog = results(page)
    expect(dialog.get_by_role("button", name="Next: Medium")).to_be_focused()
    page.keyboard.press("Escape")
    expect(dialog).to_be_hidden()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Mission control")).to_be_visible()
    page.keyboard.press("Escape")
    page.keyboard.press("n")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    expect(page.get_by_role("spinbutton", name="Map")).not_to_have_value("7")


def test_a_screen_reader_is_told_what_happens(tabs: Tabs) -> None:
    page = tabs.open("/?task=easy&seed=7&pilot=greedy")
    fly(page)
    results(page)
    expect(page.locator("#announcer")).to_contain_text(re.compile(r"Mission accomplished\. Score [\d.]+"))
    expect(page.locator("#maps canvas[role=img]")).to_have_attribute(
        "aria-label", re.compile("City map of Easy, 10 by 10")
    )
    for gauge in ("Battery", "Steps"):
        expect(page.get_by_role("meter", name=gauge, include_hidden=True)).to_have_attribute(
            "aria-valuetext", re.compile(".")
        )


@pytest.mark.parametrize("motion", ["reduce", "no-preference"])
def test_less_motion_stands_still_between_steps(tabs: Tabs, motion: str) -> None:
    page = tabs.open("/?task=hard&seed=7&pilot=greedy", reduced_motion=motion)
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    page.get_by_role("slider", name="Speed").fill("0")
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.locator("#step-counter")).to_have_text(re.compile("Step [1-9]"))
    page.wait_for_timeout(150)
    flight = page.locator("#maps canvas").last
    pictures = set()
    for _ in range(4):
        pictures.add(pixels(flight))
        page.wait_for_timeout(120)
    assert (len(pictures) == 1) == (motion == "reduce")


def test_the_page_weighs_less_than_300_kb(tabs: Tabs) -> None:
    page = tabs.open(go=False)
    answers: list[Response] = []
    page.on("response", lambda answer: answers.append(answer))
    page.goto(MISSION)
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    files = {answer.url: len(answer.body()) for answer in answers if "/static/" in answer.url or "?" in answer.url}
    assert len(files) > 20
    assert sum(files.values()) < PAGE_BYTES, sorted(files.items(), key=lambda pair: -pair[1])[:10]
    assert all(url.startswith(tabs.url) for url in files)
