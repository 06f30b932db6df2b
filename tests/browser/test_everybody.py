"""For everybody: dark and light, keyboards, screen readers, less motion, slow lines."""

import re

from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from tests.browser.shown import changed, expect_step, pictures
from tests.browser.stage import (
    FASTEST,
    at_its_end,
    at_speed,
    ended,
    press,
    show,
    standings,
    whole_view,
)

PAGE_BYTES = 300_000


def findings(page: Page, part: str = "html") -> list[str]:
    """What axe finds serious or critical in dark, and the contrasts it finds too weak in light; a line each."""
    found: list[str] = []
    for scheme, options in (("light", {"runOnly": ["color-contrast"]}), ("dark", {"resultTypes": ["violations"]})):
        page.emulate_media(color_scheme=scheme)
        expect(page.locator("html")).to_have_attribute("data-theme", scheme)
        # One line of a log or a table is enough: all are alike, and axe takes its time for each.
        page.evaluate(
            "part => part.querySelectorAll('.log li ~ li, tbody tr ~ tr').forEach(line => line.remove())",
            page.locator(part).element_handle(),
        )
        # Preloading would inject the style sheets into the page, which the page does not allow.
        answer = page.evaluate("options => axe.run(...options)", [part, {**options, "preload": False}])
        assert answer["passes"], "axe has looked at nothing"
        found += [
            f"{violation['id']}: {node['html'][:120]} ({node['failureSummary']})"
            for violation in answer["violations"]
            if violation["impact"] in ("serious", "critical")
            for node in violation["nodes"]
        ]
    return found


def test_axe_finds_nothing_serious_in_any_view_dark_or_light(page: Page) -> None:
    page.goto("/")
    page.evaluate(Axe().axe_script)
    expect_step(page, 0, 100)
    found = findings(page, "#hello")
    show(page, "/?task=easy&seed=7&pilots=human,random")
    expect(page.get_by_role("group", name="Fly")).to_be_visible()
    page.keyboard.press("ArrowRight")
    expect_step(page, 1, 60)
    found += findings(page)
    for key, dialog in (("n", "#ask"), ("?", "#help")):
        page.keyboard.press(key)
        expect(page.locator(dialog)).to_be_visible()
        found += findings(page, dialog)
        page.keyboard.press("Escape")
    at_its_end(page, 7, "/?task=easy&seed=7&pilot=pathqnet").locator("summary").click()
    expect(page.get_by_text("Success rate")).to_be_visible()
    expect(page.get_by_role("button", name=re.compile("^Step 1, "))).to_be_visible()
    found += findings(page, ".fly")
    for name in ("Compare", "Learn", "API"):
        whole_view(page, name)
        found += findings(page, "main")
    for path, shown in (
        ("view=compare&task=easy&pilots=greedy,random", ".compare-part:has(.paired)"),
        ("view=compare&task=easy&pilots=random", ".opened"),
        ("view=draw&task=easy&seed=7", "#view-draw"),
    ):
        show(page, f"/?{path}")
        expect(page.locator(shown)).to_be_visible()
        found += findings(page, shown)
    assert found == []


def test_what_is_drawn_can_be_read_in_both_themes(page: Page) -> None:
    """The numbers beside a map and in the graph, the marks on moves, the drones and ways of the pilots.

    Axe looks at words in the colours that the canvases use: large words need the contrast of a drawing (3:1).
    """
    expect(page.locator(".pilot")).not_to_have_count(0)
    pilots = [f"pilot-{who}" for who in [*range(1, page.locator(".pilot").count() + 1), "other"]]
    labels = ("good", "ink-3", "warn", "accent", "bad", "map-label")
    small = [("ink-3", "panel", 12), *((label, "ground", 12) for label in labels)]
    large = [(who, ground, 24) for who in pilots for ground in ("ground", "panel", "map-ground")]
    page.evaluate(Axe().axe_script)
    page.evaluate(
        """samples => {
            const board = document.body.appendChild(Object.assign(document.createElement("div"), { id: "samples" }));
            for (const [colour, ground, size] of samples) {
                const word = board.appendChild(Object.assign(document.createElement("p"), { textContent: colour }));
                word.style.cssText = `color: var(--${colour}); background: var(--${ground}); font-size: ${size}px`;
            }
        }""",
        [*small, *large],
    )
    found = findings(page, "#samples")
    page.locator("#samples").evaluate("board => board.remove()")
    assert len(large) > 20
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
    for key, slowest in (("<", "0.5"), (">", FASTEST)):
        for _ in range(8):
            page.keyboard.press(key)
        expect(speed).to_have_value(slowest)
    page.keyboard.press("Enter")
    ended(page)
    play = page.get_by_role("button", name="Play", exact=True)
    expect(play).to_be_focused()
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Help")).to_be_visible()
    page.keyboard.press("Escape")
    expect(play).to_be_focused()
    page.keyboard.press("Shift+Tab")
    expect(page.get_by_role("slider", name="Step of the flight that is shown")).to_be_focused()
    page.keyboard.press("ArrowLeft")
    expect_step(page, 7, 8)
    ended(page).get_by_role("button", name="Next: Medium").focus()
    page.keyboard.press("Enter")
    expect_step(page, 0, 100)
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_focused()


def test_the_focus_comes_back_from_a_dialog_and_goes_to_a_fork(page: Page) -> None:
    show(page, "/?task=easy&seed=9&pilot=human")
    expect(page.get_by_role("group", name="Fly")).to_be_visible()
    page.keyboard.press("ArrowRight")
    expect_step(page, 1, 60)
    another, dialog = page.get_by_role("button", name="New map"), page.get_by_role("dialog")
    for answer in ("Escape", "Enter"):
        another.focus()
        page.keyboard.press("Enter")
        # The button that loses nothing has the focus.
        expect(dialog.get_by_role("button", name="Go on flying")).to_be_focused()
        page.keyboard.press(answer)
        expect(another).to_be_focused()
        expect_step(page, 1, 60)
    # The key after "Try from step" is for the drone, not for the button, which stays until the fork is there.
    at_its_end(page, 7, "/?task=hard&seed=7&pilot=greedy").get_by_role("button", name="Try from step").focus()
    page.keyboard.press("Enter")
    page.keyboard.press("Space")
    expect(page.locator("#step-counter")).to_contain_text("WAIT")
    expect(standings(page)).to_have_count(2)


def test_a_key_each_steps_scrubs_shows_and_begins_again(page: Page) -> None:
    show(page, "/?task=medium&seed=7&pilot=greedy")
    expect_step(page, 0, 100)
    for key, step in ((".", 1), (".", 2), ("ArrowLeft", 1), ("Home", 0), ("ArrowRight", 1), ("End", 2), ("r", 0)):
        page.keyboard.press(key)
        expect_step(page, step, 100)
    for key, enabled in (("z", True), ("x", False), ("+", True), ("-", False)):
        page.keyboard.press(key)
        expect(page.get_by_role("button", name="Farther")).to_be_enabled(enabled=enabled)


def test_less_motion_stands_still_between_steps(page: Page) -> None:
    def between_steps() -> int:
        """The number of different pictures in ten frames between two steps that are shown."""
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

    show(page, "/?task=hard&seed=7&pilot=greedy")
    expect_step(page, 0, 160)
    at_speed(page, "0.5")
    press(page, "Start")
    expect(page.locator("#step-counter")).to_contain_text(re.compile("Step [1-9]"))
    assert between_steps() == 1
    page.emulate_media(reduced_motion="no-preference")
    at_speed(page, "1")  # the map looks at the setting when something changes
    assert between_steps() > 1
    page.emulate_media(reduced_motion="reduce")
    press(page, "Pause")
    expect(page.get_by_role("button", name="Go on")).to_be_visible()


def test_the_page_weighs_less_than_300_kb(page: Page) -> None:
    page.goto("/")
    expect_step(page, 0, 100)
    sizes: dict[str, int] = page.evaluate(
        """async () => {
            const loaded = ["navigation", "resource"].flatMap(type => performance.getEntriesByType(type));
            const size = async ({ name }) => [name, (await (await fetch(name)).arrayBuffer()).byteLength];
            return Object.fromEntries(await Promise.all(loaded.map(size)));
        }"""
    )
    assert [url for url in sizes if not url.startswith(page.url)] == []
    assert len(sizes) > 20
    assert sum(sizes.values()) < PAGE_BYTES, sorted(sizes.items(), key=lambda pair: -pair[1])[:10]
