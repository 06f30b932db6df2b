"""Draw: a map is painted, its optimum follows, and its file has the same optimum everywhere else."""

import json
import re
from pathlib import Path

from playwright.sync_api import Page, Route, expect

from drone_env.city.city_file import city_task
from drone_env.planning.optimal import solve
from tests.browser.shown import expect_step, points
from tests.browser.stage import dropped, press, show, view
from tests.browser.tabs import Tabs


def drag(page: Page, *cells: tuple[int, int]) -> None:
    """Press on the first cell, which is given as seen from the cursor, and move over the others."""
    cursor = page.locator(".draw-cursor").bounding_box()
    assert cursor
    for i, (x, y) in enumerate(cells):
        page.mouse.move(cursor["x"] + (x + 0.5) * cursor["width"], cursor["y"] + (y + 0.5) * cursor["height"])
        if i == 0:
            page.mouse.down()
    page.mouse.up()


def drag_from_corner(page: Page, *cells: tuple[int, int]) -> None:
    """The same from the corner of a map of at most 14 by 12 cells."""
    page.locator("#drawing").focus()
    for key in ("ArrowUp",) * 12 + ("ArrowLeft",) * 14:
        page.keyboard.press(key)
    drag(page, *cells)


def drawn(page: Page, path: str) -> list[list[int]]:
    """The cells of the drawing at an address, as the tab keeps them."""
    return json.loads(page.evaluate("key => sessionStorage[key]", f"drone-env-drawing {path}"))["cells"]


def test_a_map_is_drawn_and_its_file_is_worth_the_same(page: Page, shared: Tabs, tmp_path: Path) -> None:
    show(page, "/?view=draw")
    note, score = page.locator("#map-note"), page.locator("#map-optimum")
    expect(note).to_have_text("The parcel in 22 steps")
    drag_from_corner(page, (11, 11), (5, 0))
    expect(note).to_have_text("The parcel in 5 steps")
    page.get_by_role("group", name="Paint").get_by_text("Obstacle").click()
    drag_from_corner(page, (2, 0), (2, 3))
    expect(note).to_have_text("The parcel in 13 steps")
    press(page, "Undo")
    expect(note).to_have_text("The parcel in 5 steps")
    page.keyboard.press("Control+Shift+Z")
    expect(note).to_have_text("The parcel in 13 steps")
    # With the keyboard: a second parcel below the wall. It costs no step.
    page.locator("#drawing").focus()
    for key in ("7", "ArrowDown", "ArrowDown", "ArrowRight", "Space"):
        page.keyboard.press(key)
    expect(note).to_have_text("All 2 parcels in 13 steps")
    battery = page.get_by_role("spinbutton", name="Battery")
    battery.fill("14")
    battery.press("Enter")
    expect(page.locator("#map-optimum.waiting")).to_have_count(0)
    shown = score.inner_text()
    with page.expect_download() as saving:
        press(page, "Save file")
    file = tmp_path / saving.value.suggested_filename
    saving.value.save_as(file)
    task = city_task(file)
    best = solve(task, 0)
    assert (task.battery_capacity, len(best.actions), points(best.score)) == (14, 13, shown)
    shared.expect("422|404")
    page.get_by_role("group", name="Paint").get_by_text("Obstacle").click()
    drag_from_corner(page, (2, 3), (2, 11))
    page.reload()
    problem = page.locator("#view-draw").get_by_role("alert")
    expect(problem).to_contain_text("cannot be reached from start")
    # The saved file is opened again, stored and flown.
    dropped(page, file.name, file.read_text(encoding="utf-8"))
    expect(score).to_have_text(shown)
    press(page, "Fly it")
    expect_step(page, 0, 120)
    assert f"task={file.stem}&seed=0&pilot=human" in page.url
    page.reload()
    expect_step(page, 0, 120)
    page.get_by_role("link", name="Edit this map").click()
    expect(score).to_have_text(shown)
    view(page, "Fly")
    expect_step(page, 0, 120)
    # An address of no map shows neither the map before nor an empty one.
    for path, why in (("?view=draw&task=atlantis", "atlantis"), ("?view=draw&file=gone.toml", "open it again")):
        show(page, path)
        expect(page.locator("#view-draw .problem")).to_contain_text(why)
        expect(page.get_by_role("button", name="Fly it")).to_be_disabled()
        expect(score).to_have_text("–")


def test_a_late_answer_keeps_what_is_typed_and_a_drag_outside_draws_nothing(page: Page, shared: Tabs) -> None:
    late: list[Route] = []
    page.route("**/maps/worth", lambda route: late.append(route))
    with page.expect_request("**/maps/worth"):
        show(page, "/?view=draw&task=easy&seed=3")
    columns = page.get_by_role("spinbutton", name="Columns")
    expect(columns).to_have_value("10")
    columns.press("Control+A")
    columns.press("1")
    shared.expect("503")
    for route in late:
        route.fulfill(status=503, json={"code": "busy", "detail": "try again later"})
    page.unroute("**/maps/worth")
    expect(page.locator("#view-draw .problem")).to_have_text("try again later")
    expect(page.locator("#map-note")).to_have_text(re.compile("The parcel in"))
    columns.press("4")
    columns.press("Enter")
    cells = drawn(page, "easy 3")
    assert [len(row) for row in cells] == [14] * 10
    columns.fill("129")
    columns.press("Enter")
    columns.blur()
    expect(columns).to_have_value("14")
    # From the last row down, to the right, and up again: the cells between stay as they are.
    page.locator("#drawing").focus()
    page.keyboard.press("6")
    drag_from_corner(page, (0, 9), (0, 11), (13, 11), (13, 9))
    assert drawn(page, "easy 3") == [*cells[:9], [8, *cells[9][1:13], 8]]
