"""On a phone: narrow, touched, with pixels that are small; one page for all of it. And on a small screen."""

from collections.abc import Generator

import pytest
from playwright.sync_api import Browser, Locator, Page, expect

from tests.api.serving import Server
from tests.browser.conftest import lent
from tests.browser.shown import pictures
from tests.browser.stage import ended, fly, show, view, whole_view
from tests.browser.tabs import NARROW, Tabs

PIXELS_PER_PIXEL = 2
SMALL = {"width": 1024, "height": 768}


@pytest.fixture(scope="module")
def pocket(browser: Browser, server: Server) -> Generator[Tabs, None, None]:
    with Tabs(browser, server.url) as opened:
        yield opened


@pytest.fixture(scope="module")
def opened(pocket: Tabs) -> Page:
    return pocket.open(
        "/?view=learn",
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


def place(node: Locator) -> tuple[float, float, float, float]:
    """Left, top, right and bottom in the window."""
    box = node.bounding_box()
    assert box is not None
    return box["x"], box["y"], box["x"] + box["width"], box["y"] + box["height"]


def test_it_never_scrolls_sideways(phone: Page) -> None:
    show(phone, "/?task=hard&seed=14&pilots=pathqnet,greedy")
    expect(phone.locator("#standings tbody tr")).to_have_count(2)
    wide = {"Fly": too_wide(phone)}
    fly(phone)
    ended(phone).get_by_text("Efficiency, and all flights of this task").click()
    expect(phone.get_by_text("Success rate")).to_be_visible()
    wide["its end"] = too_wide(phone)
    phone.get_by_text("Hard · map 14 · PathQNet, Greedy").click()
    expect(phone.get_by_role("button", name="New map")).to_be_visible()
    wide["its plan"] = too_wide(phone)
    phone.get_by_text("Hard · map 14 · PathQNet, Greedy").click()
    phone.get_by_role("checkbox", name="A board each").check()
    expect(phone.locator("#boards .card")).to_have_count(2)
    wide["its boards"] = too_wide(phone)
    phone.get_by_role("button", name="Keys and help").click()
    left, top, right, bottom = place(phone.get_by_role("dialog", name="Help"))
    assert left >= 0
    assert top >= 0
    assert right <= NARROW["width"]
    assert bottom <= NARROW["height"]
    phone.keyboard.press("Escape")
    for name in ("Compare", "Learn", "API"):
        whole_view(phone, name)
        expect(phone.get_by_role("link", name=name, exact=True)).to_be_in_viewport(ratio=1)
        wide[name] = too_wide(phone)
    show(phone, "/?view=draw")
    expect(phone.locator("#map-note")).to_contain_text("22 steps")
    wide["Draw"] = too_wide(phone)
    phone.goto("/")
    expect(phone.locator("#step-counter")).to_contain_text("Step 0 of")
    wide["the first flight"] = too_wide(phone)
    assert {name: nodes for name, nodes in wide.items() if nodes} == {}


def test_the_plan_comes_first_and_map_pad_and_start_are_in_one_window(phone: Page) -> None:
    show(phone, "/?task=easy&seed=3&pilots=human,pathqnet")
    plan = phone.get_by_text("Easy · map 3 · You, PathQNet")
    city, pad = phone.locator("#boards .map"), phone.get_by_role("group", name="Fly")
    start = phone.get_by_role("button", name="Start", exact=True)
    expect(pad).to_be_visible()
    for node in (plan, city, pad, start):
        expect(node).to_be_in_viewport(ratio=1)
    # Whoever looks for the pilots finds them above the map; the pad is below it, where thumbs are.
    tops = [place(node)[1] for node in (plan, city, pad, start)]
    assert tops == sorted(tops)
    # Nothing lies over the map.
    assert place(phone.get_by_role("group", name="Map", exact=True))[1] >= place(city)[3]
    plan.click()
    expect(phone.get_by_role("button", name="Greedy", exact=True)).to_be_visible()
    plan.click()


def test_on_a_small_screen_start_is_above_the_fold(phone: Page) -> None:
    phone.set_viewport_size(SMALL)  # type: ignore[arg-type]
    try:
        show(phone, "/?task=hard&seed=3&pilot=pathqnet")
        expect(phone.locator("#step-counter")).to_have_text("Step 0 of 160")
        for node in ("#boards .map", ".timeline", "#start", "#score", "#step-counter"):
            expect(phone.locator(node)).to_be_in_viewport(ratio=1)
        assert too_wide(phone) == []
    finally:
        phone.set_viewport_size(NARROW)  # type: ignore[arg-type]


def test_the_specifications_fit(phone: Page) -> None:
    view(phone, "Learn")
    table = phone.locator(".specs-table").first
    expect(table).to_be_visible()
    assert table.evaluate("table => table.scrollWidth <= table.parentElement.clientWidth")
    cells = table.locator("td").evaluate_all("all => all.every(cell => cell.scrollWidth <= cell.clientWidth)")
    assert cells, "a value runs into its neighbour"


@pytest.mark.parametrize("seed", ["-1", "99999999999999999999999"])
def test_a_link_to_no_map_says_above_the_map_which_there_are(phone: Page, seed: str) -> None:
    phone.goto(f"/?seed={seed}")
    problem = phone.locator(".middle").get_by_role("alert")
    expect(problem).to_contain_text("a whole number from 0 to 9007199254740991")
    expect(problem).to_be_in_viewport()
    # There is nothing to start, and nothing that looks as if there were.
    expect(phone.locator("#start")).to_be_hidden()
    assert f"seed={seed}" in phone.url
    phone.get_by_role("button", name="Fly another map").click()
    expect(phone.locator("#step-counter")).to_have_text("Step 0 of 60")
    expect(problem).to_be_hidden()


def test_a_person_flies_by_touch_over_a_map_that_is_crisp(phone: Page) -> None:
    show(phone, "/?task=easy&seed=7&pilot=human")
    pad = phone.get_by_role("group", name="Fly")
    expect(pad).to_be_visible()
    sizes = phone.locator("#boards canvas").evaluate_all(
        "all => all.map(c => [c.width, c.height, c.clientWidth, c.clientHeight])"
    )
    assert len(sizes) == 3
    for width, height, shown_width, shown_height in sizes:
        # A canvas may be half a pixel wider than what `clientWidth` rounds.
        wrong = max(abs(width - PIXELS_PER_PIXEL * shown_width), abs(height - PIXELS_PER_PIXEL * shown_height))
        assert wrong <= PIXELS_PER_PIXEL / 2
        assert min(shown_width, shown_height) > 300
    city, _, drone = pictures(phone)
    pad.get_by_role("button", name="Down").tap()
    expect(phone.locator("#step-counter")).to_contain_text("Step 1 of 60 · DOWN")
    same, _, moved = pictures(phone)
    assert same == city
    assert moved != drone


def test_a_swipe_on_the_map_flies_there(phone: Page) -> None:
    show(phone, "/?task=easy&seed=5&pilot=human")
    expect(phone.get_by_text("Easy · map 5 · You")).to_be_visible()
    expect(phone.locator("#step-counter")).to_have_text("Step 0 of 60")
    flight = phone.locator("#boards canvas").last
    swipes = (((0, -50), "UP"), ((0, 50), "DOWN"), ((-50, 10), "LEFT"), ((50, 10), "RIGHT"))
    for step, ((x, y), action) in enumerate(swipes, 1):
        touch = {"pointerType": "touch", "isPrimary": True, "bubbles": True, "clientX": 150, "clientY": 150}
        flight.dispatch_event("pointerdown", touch)
        flight.dispatch_event("pointerup", {**touch, "clientX": 150 + x, "clientY": 150 + y})
        expect(phone.locator("#step-counter")).to_contain_text(f"Step {step} of 60 · {action}")


def test_a_map_from_nearby_moves_with_the_drone_or_with_a_finger(phone: Page) -> None:
    show(phone, "/?task=hard&seed=11&pilot=greedy")
    expect(phone.get_by_text("Hard · map 11 · Greedy")).to_be_visible()
    expect(phone.locator("#step-counter")).to_have_text("Step 0 of 160")
    ground, follow = phone.locator("#boards canvas").first, phone.get_by_role("button", name="Follow the drone")

    def corner() -> tuple[float, ...]:
        pictures(phone)
        return place(ground)

    whole = corner()
    for _ in range(4):
        phone.get_by_role("button", name="Nearer").tap()
    start = corner()
    assert start[2] - start[0] > 3 * (whole[2] - whole[0])
    expect(follow).to_be_hidden()
    fly(phone)
    ended(phone)
    assert corner()[:2] != start[:2]
    phone.get_by_role("button", name="First step").tap()
    before = corner()
    # The finger moves the map, not the page; from then on it lies where the finger has left it.
    assert phone.locator("#boards .map").evaluate("map => getComputedStyle(map).touchAction") == "none"
    touch = {"pointerType": "touch", "isPrimary": True, "bubbles": True, "pointerId": 7, "clientX": 150, "clientY": 300}
    ground.dispatch_event("pointerdown", touch)
    ground.dispatch_event("pointermove", {**touch, "clientX": 130, "clientY": 290})
    ground.dispatch_event("pointerup", touch)
    moved = corner()
    assert (moved[0] - before[0], moved[1] - before[1]) == pytest.approx((-20, -10), abs=1)
    phone.get_by_role("button", name="Step", exact=True).tap()
    assert corner() == moved
    follow.tap()
    expect(follow).to_be_hidden()
    for _ in range(4):
        phone.get_by_role("button", name="Farther").tap()
    assert corner() == whole
