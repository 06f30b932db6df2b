"""The map: its layers, asked of the server once a moment, and cities, joined to blocks and seen from nearby."""

import json
from collections.abc import Callable

from playwright.sync_api import Locator, Page, Request, Route, expect

from tests.browser.shown import box as place_of
from tests.browser.shown import changed, expect_step, painted, pictures, points
from tests.browser.stage import ended, fly, press, show, until

GROUND, CELLS, AIR = range(3)
"""The canvases of a map: the city, the layers of its cells, what moves."""
LAYERS = {
    "Best moves": ("v", CELLS),
    "Network mistakes": ("e", CELLS),
    "Battery range": ("b", CELLS),
    "Best flight": ("g", AIR),
}


def box(page: Page, name: str) -> Locator:
    return page.get_by_role("checkbox", name=name)


def test_each_layer_is_switched_by_box_and_key_and_the_server_is_asked_once_a_moment(page: Page) -> None:
    asked: list[int] = []
    held: list[Route] = []

    def note(request: Request) -> None:
        flight = json.loads(request.post_data or "{}") if request.url.endswith("/values") else {"only": "other"}
        if flight["only"] is None:  # the table of moves asks for less
            asked.append(len(flight["actions"]))

    best, cells = page.locator("#q-values tr.best"), page.locator("#boards .map-cells")
    show(page, "/?task=skyline_easy&seed=4711&pilot=greedy")
    expect_step(page, 0, 60)
    # Hidden before the end: it would show what is best.
    expect(box(page, "Best flight")).to_be_hidden()
    fly(page)
    ended(page)
    # At the end no move is left: the layers show the moment before the last step.
    before = pictures(page)
    with page.expect_response("**/values"):
        page.keyboard.press("v")
    until(page, lambda: changed(page, before) == [CELLS])
    page.keyboard.press("v")
    page.keyboard.press("e")
    expect(page.locator("#unsolved")).to_have_text("The network makes no mistake here.")
    page.keyboard.press("e")
    page.keyboard.press("Home")
    page.on("request", note)
    try:
        box(page, "Best flight").uncheck()
        bare = pictures(page)
        for name, (key, place) in LAYERS.items():
            box(page, name).check()
            until(page, lambda place=place: changed(page, bare) == [place])
            page.keyboard.press(key)
            expect(box(page, name)).not_to_be_checked()
            until(page, lambda: changed(page, bare) == [])
        assert asked == [0]
        # While the server computes, the values of the step before are dimmed, and the moves have none.
        page.keyboard.press("v")
        expect(best.first).to_be_visible()
        page.route("**/values", lambda route, _: held.append(route))
        press(page, "Step")
        until(page, lambda: bool(held))
        expect(best).to_have_count(0)
        expect(cells).to_have_css("opacity", "0.2")
        with page.expect_response("**/values") as answer:
            held[0].continue_()
        exact = answer.value.json()["q_values"]
        expect(cells).to_have_css("opacity", "1")
        for action, value in exact.items():
            row = page.locator(f"#q-values tr[data-action={action}]").get_by_role("cell")
            lost = max(exact.values()) - value
            expect(row).to_have_text([points(value), points(lost) if lost > 0.0005 else "0"])
        for key in ("Home", "ArrowRight"):
            page.keyboard.press(key)
            expect(best.first).to_be_visible()
        assert asked == [0, 1]
    finally:
        page.unroute("**/values")
        page.remove_listener("request", note)
        box(page, "Best moves").uncheck()
        box(page, "Best flight").check()


CONTRIBUTORS = "© OpenStreetMap contributors"
FIELD = "#boards .map-ground"
JOINED = ("--block-street", "--block-roof-1", "--block-wood", "--block-closed")


def test_a_city_is_joined_to_blocks_and_other_maps_show_only_what_they_have(page: Page) -> None:
    credit = page.get_by_role("link", name=CONTRIBUTORS)
    farther, nearer = (page.get_by_role("button", name=name) for name in ("Zoom out", "Zoom in"))
    show(page, "/?task=city&seed=7&pilots=greedy")
    expect(credit).to_have_attribute("href", "https://www.openstreetmap.org/copyright")
    until(page, lambda: painted(page.locator(FIELD), *JOINED) == list(JOINED))
    for _ in range(3):
        nearer.click()
    pictures(page)  # drawn
    before = place_of(page, FIELD)
    page.keyboard.press("Shift+ArrowRight")
    until(page, lambda: place_of(page, FIELD).left < before.left)
    assert place_of(page, FIELD).top == before.top
    expect(page.get_by_role("button", name="Follow the drone")).to_be_visible()
    # A person starts nearby; a map of the standard tasks has no blocks and nothing around it.
    show(page, "/?task=city&seed=7&pilots=human")
    expect(farther).to_be_enabled()
    show(page, "/?task=easy&seed=7&pilots=greedy")
    expect_step(page, 0, 60)
    expect(credit).to_be_hidden()
    until(page, lambda: painted(page.locator(FIELD), *JOINED) == [])
    # These maps have no pads.
    ranges, thoughts = box(page, "Battery range"), box(page, "Network values")
    expect(ranges).to_be_hidden()
    expect(thoughts).to_be_checked()
    columns = page.get_by_role("table", name="Each move from here").get_by_role("columnheader")
    expect(columns).to_have_text(["Move", "Network", "Still possible", "Loss"])
    # The network that flies here has no values for single moves.
    show(page, "/?task=skyline_easy&seed=7&pilot=tournet")
    expect(thoughts).to_be_hidden()
    expect(columns).to_have_text(["Move", "Still possible", "Loss"])
    expect(ranges).to_be_visible()


def test_the_map_takes_two_fifths_of_the_window(beside: Callable[..., Page]) -> None:
    page = beside("/?task=skyline_easy&seed=7&pilot=human")
    expect_step(page, 0, 60)
    for width, height in ((1440, 900), (1024, 768), (390, 844), (360, 740), (844, 390), (720, 450)):
        page.set_viewport_size({"width": width, "height": height})
        for shown in ("#battery", "#boards .map-air", "#undo", "[data-view=api]"):
            expect(page.locator(shown)).to_be_in_viewport(ratio=1)
        pictures(page)  # drawn
        size = place_of(page, "#boards .map-air")
        assert min(size.width, size.height) ** 2 >= 0.4 * width * height


def test_a_message_covers_no_button(beside: Callable[..., Page]) -> None:
    page = beside("/?view=learn")
    for path, sign in (
        ("task=skyline_easy&seed=7&pilot=human", "#boards .map-air"),
        ("task=easy&seed=5&pilots=greedy,random&step=999", ".results"),
        ("view=draw&task=skyline_easy&seed=7", "#drawing .map-air"),
        ("view=compare&task=easy&pilots=greedy,random", "dl.paired"),
    ):
        show(page, f"/?{path}")
        expect(page.locator(sign)).to_be_visible()
        for width, height in ((1440, 900), (1024, 768), (390, 844), (844, 390)):
            page.set_viewport_size({"width": width, "height": height})
            expect(page.locator(sign)).to_be_visible()
            pictures(page)  # drawn
            seen, covered = page.evaluate(
                """path => {
                    history.pushState(null, "", path);
                    dispatchEvent(new PopStateEvent("popstate"));
                    const toast = document.querySelector(".toast").getBoundingClientRect();
                    const over = one => one.left < toast.right && one.right > toast.left
                        && one.top < toast.bottom && one.bottom > toast.top;
                    const buttons = [...document.querySelectorAll("button, a, input, select, summary")]
                        .filter(one => one.checkVisibility({ visibilityProperty: true }));
                    return [
                        toast.height > 0 && toast.top >= 0 && toast.bottom < innerHeight,
                        buttons.filter(one => over(one.getBoundingClientRect())).map(one => one.outerHTML),
                    ];
                }""",
                f"/?{path}&lesson=junk",
            )
            assert (seen, covered) == (True, []), (width, path)
