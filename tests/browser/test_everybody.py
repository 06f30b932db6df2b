"""For everybody: dark and light, keyboards, screen readers, less motion, slow lines."""

import re
from typing import Any

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from tests.browser.conftest import MARKUP
from tests.browser.stage import FASTEST, fly, pictures, results, view, whole_view

MISSION = "/?task=easy&seed=7&pilot=pathqnet"
PAGE_BYTES = 300_000


def findings(page: Page, part: str = "html") -> list[str]:
    """What axe holds to be serious or critical in dark, and of the contrasts in light; a line each."""
    contrast = {"runOnly": {"type": "rule", "values": ["color-contrast"]}}
    violations: list[dict[str, Any]] = []
    for scheme, options in (("dark", {"resultTypes": ["violations"]}), ("light", contrast)):
        page.emulate_media(color_scheme=scheme)
        expect(page.locator("html")).to_have_attribute("data-theme", scheme)
        answer = page.evaluate("options => axe.run(...options)", [part, options])
        assert answer["passes"], "axe has looked at nothing"
        violations += answer["violations"]
    page.emulate_media(color_scheme="dark")
    return [
        f"{violation['id']}: {node['html'][:120]} ({node['failureSummary']})"
        for violation in violations
        if violation["impact"] in ("serious", "critical")
        for node in violation["nodes"]
    ]


def test_axe_finds_nothing_serious_in_any_view_dark_or_light(page: Page) -> None:
    page.goto(MISSION)
    page.evaluate(Axe().axe_script)
    fly(page)
    dialog = results(page)
    expect(dialog.get_by_text("Success rate")).to_be_visible()
    found = findings(page, "#results")
    dialog.get_by_role("button", name="Look at the flight").click()
    expect(page.get_by_role("button", name=re.compile("^Step 1, "))).to_be_visible()
    found += findings(page)
    view(page, "History")
    # One row, and one line of a log, is enough: all are alike, and axe takes its time for each.
    page.get_by_role("combobox", name="Task").select_option("easy")
    page.get_by_role("combobox", name="Agent").select_option(MARKUP)
    expect(page.locator("tr[data-episode]")).to_have_count(1)
    page.locator("tr[data-episode]").click()
    expect(page.locator(".facts").get_by_text("Optimum")).to_be_visible()
    for name in ("Replay", "Race", "History", "Learn", "API"):
        whole_view(page, name)
        page.evaluate("document.querySelectorAll('.log li ~ li').forEach(line => line.remove())")
        found += findings(page, "main")
    page.goto("/")
    page.evaluate(Axe().axe_script)
    found += findings(page, "#hello")
    assert found == []


def test_the_colours_are_switched_and_remembered(page: Page) -> None:
    page.goto(MISSION)
    ground = "getComputedStyle(document.documentElement).backgroundColor"
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    dark, (city, _) = page.evaluate(ground), pictures(page)
    page.get_by_role("button", name="Switch to light colours").click()
    light = page.evaluate(ground)
    assert light != dark
    assert pictures(page)[0] != city
    page.reload()
    page.get_by_role("button", name="Switch to dark colours").click()
    assert page.evaluate(ground) == dark
    page.emulate_media(color_scheme="light")
    assert page.evaluate(ground) == dark, "what a visitor has chosen outlasts the system's choice"
    page.emulate_media(color_scheme="dark")


def test_everything_goes_with_the_keyboard_alone(page: Page) -> None:
    page.goto(MISSION)
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    focused = page.locator(":focus")
    page.keyboard.press("Tab")
    expect(focused).to_have_text("Skip to the flight")
    page.keyboard.press("Enter")
    names = []
    for _ in range(40):
        page.keyboard.press("Tab")
        name, outline, around = focused.evaluate(
            "e => [e.getAttribute('aria-label') || e.innerText.trim() || e.id, getComputedStyle(e).outlineStyle,"
            "e.parentElement.className]"
        )
        names.append(name)
        assert outline != "none" or "segment" in around, name
        if name == "Start":
            break
    assert names[-1] == "Start", names
    for _ in range(4):
        page.keyboard.press("-")
    expect(page.get_by_role("slider", name="Speed")).to_have_value("0")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Pause")).to_be_focused()
    page.keyboard.press("Space")
    expect(page.get_by_role("button", name="Go on").or_(page.get_by_role("button", name="Start"))).to_be_focused()
    for _ in range(8):
        page.keyboard.press("+")
    expect(page.get_by_role("slider", name="Speed")).to_have_value(FASTEST)
    page.keyboard.press("Space")
    dialog = results(page)
    expect(dialog.get_by_role("button", name="Next: Medium")).to_be_focused()
    page.keyboard.press("Escape")
    expect(dialog).to_be_hidden()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Help")).to_be_visible()
    page.keyboard.press("Escape")
    page.keyboard.press("n")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    expect(page.get_by_role("spinbutton", name="Map")).not_to_have_value("7")


def test_a_key_each_steps_scrubs_and_begins_again(page: Page) -> None:
    page.goto("/?task=medium&seed=7&pilot=greedy")
    where, arrows = page.locator("#step-counter"), page.get_by_role("checkbox", name="Arrows on the map")
    expect(where).to_have_text("Step 0 of 100")
    for step in (1, 2, 3):
        page.keyboard.press(".")
        expect(where).to_have_text(f"Step {step} of 100")
    for key, step in (("ArrowLeft", 2), ("ArrowLeft", 1), ("ArrowRight", 2), ("Home", 0), ("End", 3)):
        page.keyboard.press(key)
        expect(where).to_have_text(f"Step {step} of 100")
    page.keyboard.press("q")
    expect(arrows).not_to_be_checked()
    page.keyboard.press("q")
    expect(arrows).to_be_checked()
    page.keyboard.press("r")
    expect(where).to_have_text("Step 0 of 100")
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value("7")


def test_less_motion_stands_still_between_steps(page: Page) -> None:
    page.goto("/?task=hard&seed=7&pilot=greedy")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    page.get_by_role("slider", name="Speed").fill("0")
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.locator("#step-counter")).to_have_text(re.compile("Step [1-9]"))
    assert between_steps(page) == 1
    page.emulate_media(reduced_motion="no-preference")
    # The map looks at what is wished for when something changes.
    page.get_by_role("slider", name="Speed").fill("1")
    assert between_steps(page) > 1
    page.emulate_media(reduced_motion="reduce")
    page.get_by_role("button", name="Pause").click()
    expect(page.get_by_role("button", name="Go on")).to_be_visible()


def between_steps(page: Page) -> int:
    """How many pictures of the flight there are in ten frames between two steps that are shown."""
    return page.evaluate(
        """async () => {
            const where = document.getElementById("step-counter");
            const flight = [...document.querySelectorAll("#maps canvas")].at(-1);
            for (;;) {
                const step = where.textContent;
                await new Promise(requestAnimationFrame);
                const pictures = new Set();
                for (let frame = 0; frame < 10; frame++) {
                    await new Promise(requestAnimationFrame);
                    pictures.add(flight.toDataURL());
                }
                await new Promise(requestAnimationFrame);
                if (where.textContent === step) return pictures.size;
            }
        }"""
    )


def test_the_page_weighs_less_than_300_kb(page: Page) -> None:
    page.goto("/")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    files: dict[str, int] = dict(
        page.evaluate(
            """async () => {
                const loaded = ["navigation", "resource"].flatMap(type => performance.getEntriesByType(type));
                const size = async ({ name }) => [name, (await (await fetch(name)).arrayBuffer()).byteLength];
                return Promise.all(loaded.filter(file => /\\/static\\/|\\/$/.test(file.name)).map(size));
            }"""
        )
    )
    site = page.url.split("?")[0]
    assert [url for url in files if not url.startswith(site)] == []
    assert len(files) > 20
    assert site in files
    assert sum(files.values()) < PAGE_BYTES, sorted(files.items(), key=lambda pair: -pair[1])[:10]
