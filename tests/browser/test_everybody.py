"""For everybody: dark and light, keyboards, screen readers, less motion, slow lines."""

import re
from collections.abc import Callable
from typing import Any

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from tests.browser.stage import FASTEST, at_its_end, at_speed, ended, fly, pictures, show, whole_view

FLIGHT = "/?task=easy&seed=7&pilot=pathqnet"
PAGE_BYTES = 300_000
LEGIBLE, SEEN = 4.5, 3.0
"""The least contrast of small text, and of what else there is to see (WCAG 2.2, AA)."""


def in_both(page: Page, look: Callable[[str], None]) -> None:
    """Look at the page in dark and in light."""
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        expect(page.locator("html")).to_have_attribute("data-theme", scheme)
        look(scheme)


def findings(page: Page, part: str = "html") -> list[str]:
    """What axe holds to be serious or critical in dark, and of the contrasts in light; a line each."""
    options = {"dark": {"resultTypes": ["violations"]}, "light": {"runOnly": ["color-contrast"]}}
    # It would put the style sheets into the page to read them, which the page does not allow.
    alike = {"preload": False}
    violations: list[dict[str, Any]] = []

    def look(scheme: str) -> None:
        # One line of a log or a table is enough: all are alike, and axe takes its time for each.
        page.evaluate(
            "part => part.querySelectorAll('.log li ~ li, tbody tr ~ tr').forEach(line => line.remove())",
            page.locator(part).element_handle(),
        )
        answer = page.evaluate("options => axe.run(...options)", [part, {**options[scheme], **alike}])
        assert answer["passes"], "axe has looked at nothing"
        violations.extend(answer["violations"])

    in_both(page, look)
    return [
        f"{violation['id']}: {node['html'][:120]} ({node['failureSummary']})"
        for violation in violations
        if violation["impact"] in ("serious", "critical")
        for node in violation["nodes"]
    ]


def test_axe_finds_nothing_serious_in_any_view_dark_or_light(page: Page) -> None:
    page.goto("/")
    page.evaluate(Axe().axe_script)
    expect(page.locator("#step-counter")).to_contain_text("Step 0 of")
    found = findings(page, "#hello")
    show(page, "/?task=easy&seed=7&pilots=human,random")
    expect(page.get_by_role("group", name="Fly")).to_be_visible()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#step-counter")).to_contain_text("Step 1 of 60")
    found += findings(page)
    page.keyboard.press("n")
    expect(page.get_by_role("dialog", name="Give up your flight at step 1?")).to_be_visible()
    found += findings(page, "#ask")
    page.keyboard.press("Escape")
    page.keyboard.press("?")
    found += findings(page, "#help")
    page.keyboard.press("Escape")
    show(page, FLIGHT)
    fly(page)
    ended(page).get_by_text("Efficiency, and all flights of this task").click()
    expect(page.get_by_text("Success rate")).to_be_visible()
    expect(page.get_by_role("button", name=re.compile("^Step 1, "))).to_be_visible()
    found += findings(page, ".fly")
    for name in ("Compare", "Learn", "API"):
        whole_view(page, name)
        found += findings(page, "main")
    show(page, "/?view=draw&task=easy&seed=7")
    expect(page.locator("#map-note")).to_contain_text("steps")
    found += findings(page, "#view-draw")
    assert found == []


def contrast(one: str, other: str) -> float:
    """Of two colours, as WCAG 2.2 defines it; `#rrggbb`."""

    def luminance(colour: str) -> float:
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    darker, lighter = sorted(map(luminance, (one, other)))
    return (lighter + 0.05) / (darker + 0.05)


def test_what_is_drawn_can_be_read_in_both_themes(page: Page) -> None:
    """The numbers beside a map and in the graph, the marks on moves, the drones and ways of the pilots."""
    expect(page.locator(".pilot")).not_to_have_count(0)
    labels = ("good", "ink-3", "warn", "accent", "bad")
    text = [("map-label", "ground"), ("ink-3", "panel"), *((label, "ground") for label in labels)]
    seen = [
        (f"pilot-{who}", ground)
        for who in [*range(1, page.locator(".pilot").count() + 1), "other"]
        for ground in ("ground", "panel", "map-ground")
    ]
    weak: list[str] = []

    def look(scheme: str) -> None:
        for least, pairs in ((LEGIBLE, text), (SEEN, seen)):
            for pair in pairs:
                colours = page.evaluate(
                    """names => {
                        const style = getComputedStyle(document.documentElement);
                        return names.map(name => style.getPropertyValue(`--${name}`));
                    }""",
                    pair,
                )
                if contrast(*colours) < least:
                    weak.append(f"{scheme}: {pair} {contrast(*colours):.2f}")

    assert len(seen) > 20
    in_both(page, look)
    assert weak == []


def test_the_colours_are_switched_and_remembered(page: Page) -> None:
    show(page, "/?task=easy&seed=8&pilot=pathqnet")
    ground = "getComputedStyle(document.documentElement).backgroundColor"
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 60")
    dark, city = page.evaluate(ground), pictures(page)[0]
    page.get_by_role("button", name="Switch to light colours").click()
    light = page.evaluate(ground)
    assert light != dark
    assert pictures(page)[0] != city
    page.reload()
    page.get_by_role("button", name="Switch to dark colours").click()
    assert page.evaluate(ground) == dark
    page.emulate_media(color_scheme="light")
    pictures(page)
    assert page.evaluate(ground) == dark, "what a visitor has chosen outlasts the system's choice"
    page.emulate_media(color_scheme="dark")


def test_everything_goes_with_the_keyboard_alone(page: Page) -> None:
    page.goto(FLIGHT)
    where, speed = page.locator("#step-counter"), page.get_by_role("combobox", name="Speed")
    expect(where).to_have_text("Step 0 of 60")
    focused = page.locator(":focus")
    page.keyboard.press("Tab")
    expect(focused).to_have_text("Skip to the flight")
    page.keyboard.press("Enter")
    names = []
    for _ in range(40):
        page.keyboard.press("Tab")
        name, outline, around = focused.evaluate(
            "e => [e.getAttribute('aria-label') || e.innerText.trim() || e.id, getComputedStyle(e).outlineStyle,"
            "getComputedStyle(e.parentElement).outlineStyle]"
        )
        names.append(name)
        assert "solid" in (outline, around), name
        if name == "Start":
            break
    assert names[-1] == "Start", names
    assert {"Easy", "Greedy", "Greedy flies along", "New map", "Nearer"} <= {*names}
    for _ in range(4):
        page.keyboard.press("<")
    expect(speed).to_have_value("0.5")
    page.keyboard.press("Enter")
    expect(page.get_by_role("button", name="Pause")).to_be_focused()
    page.keyboard.press("Space")
    expect(page.get_by_role("button", name="Go on").or_(page.get_by_role("button", name="Start"))).to_be_focused()
    for _ in range(8):
        page.keyboard.press(">")
    expect(speed).to_have_value(FASTEST)
    page.keyboard.press("Space")
    ended(page)
    expect(page.get_by_role("button", name="Play", exact=True)).to_be_focused()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Help")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.get_by_role("button", name="Play", exact=True)).to_be_focused()
    page.keyboard.press("Shift+Tab")
    expect(page.get_by_role("slider", name="Step of the flight that is shown")).to_be_focused()
    page.keyboard.press("ArrowLeft")
    expect(where).to_contain_text("Step 7 of 8")
    page.keyboard.press("n")
    expect(where).to_have_text("Step 0 of 60")
    expect(page.get_by_role("spinbutton", name="Map")).not_to_have_value("7")
    page.keyboard.press("End")
    page.keyboard.press(" ")
    ended(page).get_by_role("button", name="Next: Medium").focus()
    page.keyboard.press("Enter")
    expect(where).to_have_text("Step 0 of 100")
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_focused()


def test_a_dialog_that_closes_gives_the_focus_back(page: Page) -> None:
    show(page, "/?task=easy&seed=9&pilot=human")
    expect(page.get_by_role("group", name="Fly")).to_be_visible()
    page.keyboard.press("ArrowRight")
    where, another = page.locator("#step-counter"), page.get_by_role("button", name="New map")
    expect(where).to_contain_text("Step 1 of 60")
    question = page.get_by_role("dialog", name="Give up your flight at step 1?")
    for answer in ("Escape", "Enter"):
        another.focus()
        page.keyboard.press("Enter")
        # What is not given up by mistake is what has the focus.
        expect(question.get_by_role("button", name="Go on flying")).to_be_focused()
        page.keyboard.press(answer)
        expect(question).to_be_hidden()
        expect(another).to_be_focused()
        expect(where).to_contain_text("Step 1 of 60")
    helping = page.get_by_role("button", name="Keys and help")
    helping.click()
    page.get_by_role("dialog").get_by_role("button", name="Close").click()
    expect(helping).to_be_focused()


def test_the_key_after_try_from_step_is_for_the_drone(page: Page) -> None:
    """Not for the button, which stands there until the fork does."""
    at_its_end(page, 7, "/?task=hard&seed=7&pilot=greedy").get_by_role("button", name="Try from step").focus()
    page.keyboard.press("Enter")
    page.keyboard.press("Space")
    expect(page.locator("#step-counter")).to_contain_text("WAIT")
    expect(page.locator("#standings tbody tr")).to_have_count(2)


def test_a_key_each_steps_scrubs_shows_and_begins_again(page: Page) -> None:
    show(page, "/?task=medium&seed=7&pilot=greedy")
    where, arrows = page.locator("#step-counter"), page.get_by_role("checkbox", name="What the network thinks")
    expect(where).to_have_text("Step 0 of 100")
    for step in (1, 2, 3):
        page.keyboard.press(".")
        expect(where).to_contain_text(f"Step {step} of 100")
    for key, step in (("ArrowLeft", 2), ("ArrowLeft", 1), ("ArrowRight", 2), ("Home", 0), ("End", 3)):
        page.keyboard.press(key)
        expect(where).to_contain_text(f"Step {step} of 100")
    before = pictures(page)[-1]
    page.keyboard.press("q")
    expect(arrows).not_to_be_checked()
    assert pictures(page)[-1] != before
    page.keyboard.press("q")
    expect(arrows).to_be_checked()
    assert pictures(page)[-1] == before
    at_speed(page, "6")
    page.locator("#speed").blur()
    for key, speed in ((">", "10"), ("<", "6")):
        page.keyboard.press(key)
        expect(page.get_by_role("combobox", name="Speed")).to_have_value(speed)
    for key, enabled in (("z", True), ("x", False), ("+", True), ("-", False)):
        page.keyboard.press(key)
        expect(page.get_by_role("button", name="Farther")).to_be_enabled(enabled=enabled)
    page.keyboard.press("r")
    expect(where).to_have_text("Step 0 of 100")
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value("7")


def test_less_motion_stands_still_between_steps(page: Page) -> None:
    show(page, "/?task=hard&seed=7&pilot=greedy")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 160")
    at_speed(page, "0.5")
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.locator("#step-counter")).to_contain_text(re.compile("Step [1-9]"))
    assert between_steps(page) == 1
    page.emulate_media(reduced_motion="no-preference")
    # The map looks at what is wished for when something changes.
    at_speed(page, "1")
    assert between_steps(page) > 1
    page.emulate_media(reduced_motion="reduce")
    page.get_by_role("button", name="Pause").click()
    expect(page.get_by_role("button", name="Go on")).to_be_visible()


def between_steps(page: Page) -> int:
    """How many pictures of the flight there are in ten frames between two steps that are shown."""
    return page.evaluate(
        """async () => {
            const where = document.getElementById("step-counter");
            const flight = [...document.querySelectorAll("#boards canvas")].at(-1);
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
    expect(page.locator("#step-counter")).to_contain_text("Step 0 of")
    files: dict[str, int] = dict(
        page.evaluate(
            """async () => {
                const loaded = ["navigation", "resource"].flatMap(type => performance.getEntriesByType(type));
                const size = async ({ name }) => [name, (await (await fetch(name)).arrayBuffer()).byteLength];
                return Promise.all(loaded.map(size));
            }"""
        )
    )
    site = page.url.split("?")[0]
    assert [url for url in files if not url.startswith(site)] == []
    assert len(files) > 20
    assert site in files
    assert sum(files.values()) < PAGE_BYTES, sorted(files.items(), key=lambda pair: -pair[1])[:10]
