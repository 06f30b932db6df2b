"""On a phone: narrow, touched, with pixels that are small; one page for all of it."""

from collections.abc import Generator

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.api.serving import Server
from tests.browser.conftest import lent
from tests.browser.stage import SIGNS, fly, pictures, results, view, whole_view
from tests.browser.tabs import NARROW, Tabs

PIXELS_PER_PIXEL = 2


@pytest.fixture(scope="module")
def pocket(browser: Browser, server: Server) -> Generator[Tabs, None, None]:
    with Tabs(browser, server.url) as opened:
        yield opened


@pytest.fixture(scope="module")
def opened(pocket: Tabs) -> Page:
    return pocket.open(
        "/#specs",
        viewport=NARROW,
        has_touch=True,
        is_mobile=True,
        device_scale_factor=PIXELS_PER_PIXEL,
        reduced_motion="reduce",
    )


@pytest.fixture
def phone(opened: Page, pocket: Tabs) -> Generator[Page, None, None]:
    with lent(opened, pocket) as page:
        yield page


def too_wide(page: Page) -> list[str]:
    """What reaches over the right edge."""
    return page.evaluate(
        """() => document.documentElement.scrollWidth <= innerWidth ? [] :
            [...document.querySelectorAll("body *")].filter(e => e.getBoundingClientRect().right > innerWidth + 1)
                .map(e => e.tagName + "." + e.className + "#" + e.id)"""
    )


def test_it_never_scrolls_sideways(phone: Page) -> None:
    phone.goto("/?task=easy&seed=14&pilot=pathqnet")
    expect(phone.locator("#step-counter")).to_have_text("Step 0 of 60")
    expect(phone.get_by_role("button", name="Start", exact=True)).to_be_in_viewport()
    wide = {"Watch": too_wide(phone)}
    fly(phone)
    dialog = results(phone)
    expect(dialog.get_by_text("Success rate")).to_be_visible()
    wide["Results"] = too_wide(phone)
    box = dialog.bounding_box()
    assert box is not None
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= NARROW["width"]
    dialog.get_by_role("button", name="Close").click()
    view(phone, "History")
    phone.locator("tr[data-episode]").first.click()
    expect(phone.locator(".facts").get_by_text("Optimum")).to_be_visible()
    for name in SIGNS:
        whole_view(phone, name)
        wide[name] = too_wide(phone)
    assert {name: nodes for name, nodes in wide.items() if nodes} == {}


def test_the_specifications_fit(phone: Page) -> None:
    view(phone, "Learn")
    table = phone.locator(".specs-table")
    expect(table).to_be_visible()
    assert table.evaluate("table => table.scrollWidth <= table.parentElement.clientWidth")
    cells = table.locator("td").evaluate_all("all => all.every(cell => cell.scrollWidth <= cell.clientWidth)")
    assert cells, "a value runs into its neighbour"


@pytest.mark.parametrize("seed", ["-1", "99999999999999999999999"])
def test_a_link_to_no_map_says_above_the_maps_which_there_are(phone: Page, seed: str) -> None:
    phone.goto(f"/?seed={seed}")
    problem = phone.locator("#deck").get_by_role("alert")
    expect(problem).to_contain_text("a whole number from 0 to 9007199254740991")
    expect(problem).to_be_in_viewport()
    assert f"seed={seed}" in phone.url
    phone.get_by_role("button", name="New map").click()
    expect(phone.locator("#step-counter")).to_have_text("Step 0 of 60")
    expect(problem).to_be_hidden()


def test_a_person_flies_by_touch_over_a_map_that_is_crisp(phone: Page) -> None:
    phone.goto("/?task=easy&seed=7&pilot=human")
    expect(phone.locator("#step-counter")).to_have_text("Step 0 of 60")
    sizes = phone.locator("#maps canvas").evaluate_all(
        "all => all.map(c => [c.width, c.height, c.clientWidth, c.clientHeight])"
    )
    assert len(sizes) == 2
    for width, height, shown_width, shown_height in sizes:
        # A canvas may be half a pixel wider than what `clientWidth` rounds.
        wrong = max(abs(width - PIXELS_PER_PIXEL * shown_width), abs(height - PIXELS_PER_PIXEL * shown_height))
        assert wrong <= PIXELS_PER_PIXEL / 2
        assert min(shown_width, shown_height) > 300
    city, drone = pictures(phone)
    phone.get_by_role("group", name="Fly").get_by_role("button", name="Down").tap()
    expect(phone.locator("#step-counter")).to_have_text("Step 1 of 60")
    expect(phone.locator("#events li").first).to_contain_text("1")
    same, moved = pictures(phone)
    assert same == city
    assert moved != drone


def test_a_swipe_on_the_map_flies_there(phone: Page) -> None:
    phone.goto("/?task=easy&seed=7&pilot=human")
    raw = phone.locator("#raw-frame")
    expect(phone.locator("#step-counter")).to_have_text("Step 0 of 60")
    phone.get_by_text("Raw telemetry").click()
    flight = phone.locator("#maps canvas").last
    swipes = (((0, -50), "UP"), ((0, 50), "DOWN"), ((-50, 10), "LEFT"), ((50, 10), "RIGHT"))
    for step, ((x, y), action) in enumerate(swipes, 1):
        touch = {"pointerType": "touch", "bubbles": True, "clientX": 150, "clientY": 150}
        flight.dispatch_event("pointerdown", touch)
        flight.dispatch_event("pointerup", {**touch, "clientX": 150 + x, "clientY": 150 + y})
        expect(phone.locator("#step-counter")).to_have_text(f"Step {step} of 60")
        expect(raw).to_contain_text(f'"action": "{action}"')
