"""Draw: a map is painted, its optimum follows, and its file is worth the same everywhere else."""

import json
import re
from pathlib import Path

import gymnasium
import pytest
from playwright.sync_api import Page, Route, expect

from drone_env.city.city_file import city_task
from drone_env.cli import main
from drone_env.core.tasks import TASKS
from drone_env.envs.registry import PLUGINS
from drone_env.graders import GRADERS
from drone_env.planning.optimal import solve
from tests.browser.stage import dropped, points, show, view
from tests.browser.tabs import Tabs


def drag(page: Page, *cells: tuple[int, int]) -> None:
    """Press on the first cell, and go over the others. The start must be at [0, 0]."""
    grid = page.locator("#drawing")
    grid.focus()
    page.keyboard.press("ArrowUp")
    corner = page.locator(".draw-cursor").bounding_box()
    assert corner is not None
    for i, (x, y) in enumerate(cells):
        page.mouse.move(corner["x"] + (x + 0.5) * corner["width"], corner["y"] + (y + 0.5) * corner["height"])
        if i == 0:
            page.mouse.down()
    page.mouse.up()


def drawn(page: Page, path: str) -> list[list[int]]:
    """The cells that the drawing of an address has, as the tab keeps them."""
    return json.loads(page.evaluate("key => sessionStorage[key]", f"drone-env-drawing {path}"))["cells"]


def test_a_map_is_drawn_and_its_file_is_worth_the_same(
    page: Page,
    shared: Tabs,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(PLUGINS, "")
    show(page, "/?view=draw")
    note, score = page.locator("#map-note"), page.locator("#map-optimum")
    expect(note).to_have_text("The parcel in 22 steps")
    drag(page, (11, 11), (5, 0))
    expect(note).to_have_text("The parcel in 5 steps")
    paint = page.get_by_role("group", name="Paint")
    paint.get_by_text("Obstacle").click()
    drag(page, (2, 0), (2, 3))
    expect(note).to_have_text("The parcel in 13 steps")
    page.get_by_role("button", name="Undo").click()
    expect(note).to_have_text("The parcel in 5 steps")
    page.keyboard.press("Control+Shift+Z")
    page.locator("#drawing").focus()
    expect(note).to_have_text("The parcel in 13 steps")
    # By the keyboard: a parcel below the wall, and a building in its way.
    page.keyboard.press("7")
    for key in ("ArrowDown", "ArrowDown", "ArrowRight", "Space"):
        page.keyboard.press(key)
    expect(note).to_have_text("All 2 parcels in 13 steps")
    battery = page.get_by_role("spinbutton", name="Battery")
    battery.fill("14")
    battery.press("Enter")
    expect(note).to_have_text("All 2 parcels in 13 steps")
    expect(page.locator("#map-optimum.waiting")).to_have_count(0)
    shown = score.inner_text()
    with page.expect_download() as saving:
        page.get_by_role("button", name="Save file").click()
    file = tmp_path / saving.value.suggested_filename
    saving.value.save_as(file)
    best = solve(city_task(file), 0)
    assert points(best.score) == shown
    assert main(["fly", "--task", str(file), "--agent", "optimal", "--seed", "0"]) == 0
    assert f"optimal scored {best.score:.4f} in 13 steps" in capsys.readouterr().err
    del gymnasium.registry[TASKS.pop(file.stem).gym_id], GRADERS[file.stem]
    shared.expect("422")
    paint.get_by_text("Obstacle").click()
    drag(page, (2, 3), (2, 11))
    expect(page.locator("#view-draw").get_by_role("alert")).to_contain_text("cannot be reached from start")
    page.reload()
    expect(page.locator("#view-draw").get_by_role("alert")).to_contain_text("cannot be reached from start")
    # What was saved is opened again, kept and flown.
    dropped(page, file.name, file.read_text(encoding="utf-8"))
    expect(score).to_have_text(shown)
    page.get_by_role("button", name="Fly it").click()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 120")
    assert f"task={file.stem}&seed=0&pilot=human" in page.url
    page.reload()
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 120")
    page.get_by_role("link", name="Edit this map").click()
    expect(score).to_have_text(shown)
    view(page, "Fly")
    expect(page.locator("#step-counter")).to_have_text("Step 0 of 120")
    # Where there is no such map, none stands there: neither the one before nor an empty one.
    problem = page.locator("#view-draw .problem")
    for path, why in (("?view=draw&task=atlantis", "atlantis"), ("?view=draw&file=gone.toml", "open it again")):
        shared.expect("404")
        show(page, path)
        expect(problem).to_contain_text(why)
        expect(page.get_by_role("button", name="Fly it")).to_be_disabled()
        expect(score).to_have_text("–")


def test_what_is_typed_stays_while_the_server_answers_and_a_drag_outside_draws_nothing_inside(
    page: Page, shared: Tabs
) -> None:
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
    # From the last row down, to the right, and up again: nothing is drawn on the way between.
    grid = page.locator("#drawing")
    grid.focus()
    page.keyboard.press("6")
    page.keyboard.press("ArrowUp")
    for _ in range(10):
        page.keyboard.press("ArrowDown")
    for _ in range(14):
        page.keyboard.press("ArrowLeft")
    corner = page.locator(".draw-cursor").bounding_box()
    assert corner is not None
    side, left, top = corner["width"], corner["x"], corner["y"]
    for i, (x, y) in enumerate([(0, 0), (0, 2), (13, 2), (13, 0)]):
        page.mouse.move(left + (x + 0.5) * side, top + (y + 0.5) * side)
        if i == 0:
            page.mouse.down()
    page.mouse.up()
    assert drawn(page, "easy 3") == [*cells[:9], [8, *cells[9][1:13], 8]]


def test_the_page_says_that_a_map_of_a_stranger_is_not_kept(shared: Tabs) -> None:
    shared.forget()
    # A proxy adds this header; its callers may be strangers.
    page = shared.open("/?view=draw", extra_http_headers={"X-Forwarded-For": "192.0.2.1"})
    expect(page.locator("#map-note")).to_have_text("The parcel in 22 steps")
    shared.expect("403")
    page.get_by_role("button", name="Fly it").click()
    expect(page.locator("#toasts")).to_contain_text("this server keeps no drawn maps: save yours as a file")
    page.close()
    assert shared.unexpected() == []
