"""On a phone: narrow, touched, with small pixels; one page for all tests. And on a small screen."""

from collections.abc import Generator

import pytest
from playwright.sync_api import Locator, Page, Route, expect

from tests.browser.conftest import lent
from tests.browser.shown import box, expect_step, measured, pictures
from tests.browser.stage import at_its_end, ended, fly, show, standings, view
from tests.browser.tabs import NARROW, Tabs

PIXELS_PER_PIXEL = 2


@pytest.fixture(scope="module")
def opened(shared: Tabs) -> Page:
    touched = {"viewport": NARROW, "has_touch": True, "is_mobile": True, "device_scale_factor": PIXELS_PER_PIXEL}
    return shared.open("/?view=learn", **touched)


@pytest.fixture
def phone(opened: Page, shared: Tabs) -> Generator[Page, None, None]:
    with lent(opened, shared) as page:
        yield page


def expect_no_wider(page: Page) -> None:
    """Nothing reaches over the right edge."""
    # If a page is too wide, a phone zooms out, and the inner width grows, too.
    widths = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    assert widths == [(page.viewport_size or NARROW)["width"]] * 2, page.url


def swipe(node: Locator, right: float, down: float) -> None:
    """Move a finger over an element."""
    touch = {"pointerType": "touch", "isPrimary": True, "bubbles": True, "pointerId": 7}
    here, there = {"clientX": 150, "clientY": 200}, {"clientX": 150 + right, "clientY": 200 + down}
    for event, at in (("pointerdown", here), ("pointermove", there), ("pointerup", there)):
        node.dispatch_event(event, {**touch, **at})


def test_it_never_scrolls_sideways(phone: Page) -> None:
    at_its_end(phone, 14, "/?task=easy&seed=14&pilots=pathqnet,greedy")
    expect(standings(phone)).to_have_count(2)
    flight = phone.get_by_text("Easy · map 14 · PathQNet, Greedy")
    flight.click()
    expect(phone.get_by_role("button", name="New map")).to_be_visible()
    expect_no_wider(phone)
    flight.click()
    for name, sign in (("Compare", "tbody tr"), ("API", "#log-requests li"), ("Learn", ".lesson")):
        view(phone, name)
        expect(phone.locator(f".view:visible {sign}").first).to_be_visible()
        expect(phone.get_by_role("link", name=name, exact=True)).to_be_in_viewport(ratio=1)
        expect_no_wider(phone)
    # The tables of Compare do not scroll sideways either, and show all columns.
    for chosen, sign in (("pilots=greedy,random", "dl.paired"), ("pilot=random", ".losses")):
        show(phone, f"/?view=compare&task=easy&{chosen}")
        expect(phone.locator(sign).first).to_be_visible()
        expect_no_wider(phone)
        assert all(measured(phone, "#view-compare .scroller", "one.scrollWidth <= one.clientWidth"))
        assert "none" not in measured(phone, "#view-compare td", "getComputedStyle(one).display")
    show(phone, "/?view=draw")
    expect(phone.locator("#map-note")).to_contain_text("22 steps")
    expect_no_wider(phone)
    phone.goto("/")
    expect_step(phone, 0, 100)
    expect_no_wider(phone)


def test_a_person_flies_by_touch_over_a_map_that_is_crisp(phone: Page) -> None:
    show(phone, "/?task=easy&seed=5&pilot=human")
    expect_step(phone, 0, 60)
    # A canvas may be half a pixel wider than its rounded `clientWidth`.
    for width, shown in measured(phone, "#boards canvas", "[one.width, one.clientWidth]"):
        assert width == pytest.approx(PIXELS_PER_PIXEL * shown, abs=PIXELS_PER_PIXEL / 2)
    phone.get_by_role("group", name="Fly").get_by_role("button", name="Down").tap()
    expect_step(phone, 1, 60, "DOWN")
    # A swipe on the map flies there.
    for step, (way, action) in enumerate((((0, -50), "UP"), ((50, 10), "RIGHT")), 2):
        swipe(phone.locator("#boards canvas").last, *way)
        expect_step(phone, step, 60, action)


def test_a_tap_that_is_on_its_way_at_the_end_of_a_flight_presses_nothing(phone: Page) -> None:
    show(phone, "/?task=skyline_easy&seed=7&pilot=human")
    expect_step(phone, 0, 60)
    phone.evaluate("""() => {
        const view = document.getElementById("view-fly");
        new MutationObserver(() => (view.dataset.rested = "")).observe(view, { attributeFilter: ["inert"] });
    }""")
    for _ in range(11):  # back and forth until the battery is empty
        for key in ("ArrowLeft", "ArrowRight"):
            phone.keyboard.press(key)
    expect(phone.locator("#view-fly")).to_have_attribute("data-rested", "")
    phone.get_by_role("button", name="Try again from").tap()
    expect(phone.locator("#results-title")).to_be_hidden()


def test_a_phone_on_its_side_shows_map_battery_and_pad_also_in_a_lesson(phone: Page) -> None:
    phone.set_viewport_size({"width": 844, "height": 390})
    show(phone, "/?task=easy&seed=18&pilot=human&lesson=1")
    expect_step(phone, 0, 60)
    for part in ("#boards .map-air", "#battery", ".pad", "#undo", "#copy-link"):
        expect(phone.locator(part)).to_be_in_viewport(ratio=1)
    flight = phone.get_by_text("Easy · map 18 · You")
    flight.click()
    expect(phone.locator(".plan-choices")).to_be_in_viewport(ratio=1)
    expect_no_wider(phone)
    flight.click()
    show(phone, "/?view=draw&task=skyline_easy&seed=7")
    expect(phone.locator("#map-note")).to_contain_text("All 3 parcels")
    expect(phone.locator("#drawing .map-air")).to_be_in_viewport(ratio=1)
    drawn = box(phone, "#drawing .map-air")
    assert min(drawn.width, drawn.height) > 0.75 * 390
    expect_no_wider(phone)
    phone.set_viewport_size(NARROW)  # type: ignore[arg-type]


@pytest.mark.long
def test_a_map_from_nearby_moves_with_the_drone_or_with_a_finger(phone: Page) -> None:
    def place() -> tuple[float, float, float]:
        """Left, top and width of the city."""
        pictures(phone)  # drawn
        city = box(phone, "#boards .map-ground")
        return city.left, city.top, city.width

    show(phone, "/?task=easy&seed=11&pilot=greedy")
    expect_step(phone, 0, 60)
    whole = place()
    for _ in range(4):
        phone.get_by_role("button", name="Zoom in").tap()
    start = place()
    assert start[2] > 3 * whole[2]
    fly(phone)
    ended(phone)
    assert place()[:2] != start[:2]
    phone.get_by_role("button", name="First step").tap()
    before = place()
    # The finger moves the map, not the page; the map then stays where the finger has left it.
    assert phone.locator("#boards .map").evaluate("map => getComputedStyle(map).touchAction") == "pinch-zoom"
    swipe(phone.locator("#boards .map-ground"), -20, -10)
    moved = place()
    assert (moved[0] - before[0], moved[1] - before[1]) == pytest.approx((-20, -10), abs=1)
    phone.get_by_role("button", name="Step", exact=True).tap()
    assert place() == moved
    phone.get_by_role("button", name="Follow the drone").tap()
    for _ in range(4):
        phone.get_by_role("button", name="Zoom out").tap()
    phone.get_by_role("button", name="Reset").tap()  # scrolls back to the map
    expect(phone.locator(".plan-bar")).to_be_in_viewport(ratio=1)
    phone.evaluate("scrollTo(0, 0)")
    assert place() == whole


def test_nothing_moves_when_the_font_comes_late(shared: Tabs) -> None:
    page, held = shared.open(viewport={"width": 844, "height": 390}), list[Route]()
    page.route("**/*.woff2", lambda route, _: held.append(route))
    page.goto("/", wait_until="commit")
    expect_step(page, 0, 100)
    for route in held:
        route.continue_()
    pictures(page)  # drawn with the font
    shift: float = page.evaluate(
        """() => new Promise(done => new PerformanceObserver(list => done(list.getEntries().map(({ value }) => value)))
            .observe({ type: "layout-shift", buffered: true }) || setTimeout(done, 500, []))
            .then(shifts => shifts.reduce((sum, value) => sum + value, 0))"""
    )
    assert (len(held) > 0, shift <= 0.02) == (True, True), shift
    page.context.close()
