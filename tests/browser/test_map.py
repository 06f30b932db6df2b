"""The map: its layers, asked of the server once a moment, and cities, joined to blocks and seen from nearby."""

import io
import json
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence
from playwright.sync_api import Locator, Page, Request, Route, expect

from tests.browser.shown import box as place_of
from tests.browser.shown import changed, expect_step, measured, painted, pictures, points
from tests.browser.stage import ended, fly, press, show, slider, until
from tests.browser.tabs import SMALL

GROUND, CELLS, AIR = range(3)
"""The canvases of a map: the city, the layers of its cells, what moves."""
LAYERS = {
    "Best moves": ("v", CELLS),
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
        page.keyboard.press("Home")
        expect(best.first).to_be_visible()
        assert asked == [0, 1]
        # At the end no move is left: the layers show the moment before the last step.
        page.unroute("**/values")
        with page.expect_response("**/values"):
            page.keyboard.press("End")
        expect(cells).to_have_css("opacity", "1")
    finally:
        page.unroute("**/values")
        page.remove_listener("request", note)
        box(page, "Best moves").uncheck()
        box(page, "Best flight").check()


CONTRIBUTORS = "© OpenStreetMap contributors"
FIELD = "#boards .map-ground"
JOINED = ("--block-street", "--block-roof", "--block-wood", "--block-closed")


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


@pytest.mark.long
def test_a_message_moves_nothing_and_covers_no_button_of_a_flight(beside: Callable[..., Page]) -> None:
    page = beside("/?view=learn")
    for path, sign in (
        ("task=easy&seed=5&pilots=greedy,random&step=999", ".results"),
        ("view=draw&task=skyline_easy&seed=7", "#drawing .map-air"),
        ("view=compare&task=easy&pilots=greedy,random", "dl.paired"),
    ):
        show(page, f"/?{path}")
        expect(page.locator(sign)).to_be_visible()
        for width, height in ((1440, 900), (390, 844), (844, 390)):
            page.set_viewport_size({"width": width, "height": height})
            pictures(page)  # drawn
            before = place_of(page, "main > .view:not([hidden])")
            show(page, f"/?{path}&lesson=junk")
            toast = place_of(page, ".toast:last-child")
            assert 0 <= toast.top <= height - toast.height, (width, path)
            assert place_of(page, "main > .view:not([hidden])") == before, (width, path)
            if sign == "dl.paired":
                continue  # it takes no click
            shown = "one.checkVisibility() && (({ x, y, width, height }) => [x, y, width, height])"
            sides = f"{shown}(one.getBoundingClientRect())"
            for left, top, wide, high in filter(None, measured(page, "button, a, input, select, summary", sides)):
                across = left < toast.left + toast.width and left + wide > toast.left
                assert not (across and top < toast.top + toast.height and top + high > toast.top), (width, path)


def test_the_range_of_the_battery_is_an_outline_and_the_signs_keep_their_strength(page: Page) -> None:
    show(page, "/?task=skyline_hard&seed=7&pilot=greedy&step=12")
    expect_step(page, 12, 160)
    cells = page.locator("#boards .map-cells")
    inked = "canvas => { const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height); \
        return data.filter((value, i) => i % 4 === 3 && value > 0).length / (canvas.width * canvas.height); }"
    air = pictures(page)[AIR]
    with page.expect_response("**/values"):
        box(page, "Battery range").check()
    until(page, lambda: painted(cells, "--range") == ["--range"])
    # A wash would ink each cell; what moves, pads and barricades are above the layer.
    assert 0 < cells.evaluate(inked) < 0.12
    assert pictures(page)[AIR] == air
    box(page, "Battery range").uncheck()


def test_a_city_has_names_a_scale_and_a_legend_and_standard_maps_have_scenery(page: Page) -> None:
    legend = page.get_by_role("list", name="Battery units of a step").get_by_role("listitem")
    show(page, "/?task=city&seed=7&pilot=greedy")
    expect(legend).to_have_text(["road 1", "tree 2", "building 3", "hatched closed", "pad +8", "any order"])
    tasks = {task["id"]: task for task in page.request.get("/tasks").json()["tasks"]}
    city = tasks["city"]
    assert (city["cell"], ["Kluuvi", 42.5, 18, None] in city["names"]) == (16, True)
    # Without its names and its scale, other pixels: the ground and what is above it.
    written = pictures(page)
    plain = {**tasks, "city": {**city, "cell": None, "names": []}}
    page.route("**/tasks", lambda route: route.fulfill(json={"tasks": [*plain.values()]}))
    try:
        page.reload()
        expect(legend).to_have_text(["road 1", "tree 2", "building 3", "hatched closed", "pad +8", "any order"])
        until(page, lambda: changed(page, written) == [GROUND, AIR])
    finally:
        page.unroute("**/tasks")
    page.goto("/?task=easy&seed=7&pilot=greedy")
    expect(legend).to_have_text(["each step 1", "buildings are scenery here", "any order"])


def test_the_map_is_saved_as_an_image_and_its_flights_as_a_film(page: Page) -> None:
    show(page, "/?task=easy&seed=14&pilot=greedy&step=999")
    ended(page)
    opened: list[Image.Image] = []
    for button, name in (("Save image", "drone-easy-14.png"), ("Save film", "drone-easy-14.gif")):
        with page.expect_download() as saved:
            page.get_by_role("button", name=button).click()
        assert saved.value.suggested_filename == name
        opened.append(Image.open(io.BytesIO(Path(saved.value.path()).read_bytes())))
    image, film = opened
    assert image.size == (1200, 1296)
    assert (film.size, film.n_frames) == ((480, 528), int(slider(page).get_attribute("max") or 0) + 1)
    frames = [np.asarray(frame.convert("RGB"), np.int16) for frame in ImageSequence.Iterator(film)]
    assert all((one != other).any() for one, other in pairwise(frames))
    # The film ends with what the image shows; a cell has another whole number of pixels.
    still = np.asarray(image.convert("RGB").resize((480, 518)), np.int16)
    assert np.abs(frames[-1][:480] - still[:480]).mean() < np.abs(frames[0][:480] - still[:480]).mean()
    expect(page.get_by_role("button", name="Save film")).to_be_enabled()


def test_a_screen_reader_hears_each_move_and_reads_where_everything_is(page: Page) -> None:
    heard = page.locator("#announcer")
    show(page, "/?task=skyline_easy&seed=7&pilot=human")
    expect(heard).to_contain_text("Column 7, row 4. Battery 11 of 11. Up: Road: costs 1 unit. Down:")
    page.keyboard.press("ArrowUp")
    expect(heard).to_have_text(re.compile(r"^Column 7, row 3\. Battery 10 of 11\. Up: .*Right: edge of the map\.$"))
    page.keyboard.press("ArrowRight")
    # The event of a move is announced before the place.
    expect(heard).to_have_text(re.compile(r"^.*\. Column 7, row 3\. Battery 9 of 11\."))
    page.get_by_text("The map in words").click()
    words = page.locator(".text-map")
    terms = ["You", "Around it", "Target", "Parcels to deliver", "Delivered", "Pads", "Closed"]
    expect(words.get_by_role("term")).to_have_text(terms)
    expect(words).to_contain_text("column 7, row 3.")
    page.keyboard.press("ArrowDown")
    expect(words).to_contain_text("column 7, row 4.")


def test_forced_colours_and_large_text_keep_bars_dots_title_and_standings(page: Page) -> None:
    show(page, "/?task=skyline_hard&seed=7&pilots=greedy,tournet&step=12")
    expect_step(page, 12, 160)
    colour = "one => getComputedStyle(one, {pseudo}).backgroundColor"
    shown = {"#battery .gauge-bar i": "null", ".standing-name": "'::before'", ".pips i.done": "null"}
    page.emulate_media(forced_colors="active")
    ground = page.locator("body").evaluate("one => getComputedStyle(one.parentElement).backgroundColor")
    for selector, pseudo in shown.items():
        assert page.locator(selector).first.evaluate(colour.replace("{pseudo}", pseudo)) != ground
    page.emulate_media(forced_colors="none")
    page.evaluate("document.documentElement.style.fontSize = '200%'")
    try:
        for width, height in ((1440, 900), (1024, 768), (390, 844)):
            page.set_viewport_size({"width": width, "height": height})
            pictures(page)  # drawn
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            assert place_of(page, ".plan-head").width > width / 4
            cut = measured(page, ".middle button, .side button", "one.scrollWidth > one.clientWidth + 1")
            assert not any(cut)
            assert place_of(page, ".standings-panel").height > 100
    finally:
        page.evaluate("document.documentElement.style.fontSize = ''")
        page.set_viewport_size(SMALL)
