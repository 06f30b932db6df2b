"""Draw: a map is painted, its optimum follows, and its file has the same optimum everywhere else."""

import re
from pathlib import Path

from playwright.sync_api import Page, Route, expect

from drone_env.city.city_file import city_task
from drone_env.planning.optimal import solve
from tests.browser.shown import box, expect_flying, expect_step, pictures, points
from tests.browser.stage import choices, enter, keys, open_file, press, show, until, view
from tests.browser.tabs import Tabs


def drag(page: Page, *cells: tuple[int, int]) -> None:
    """Press on the first cell and move over the others."""
    page.locator("#drawing").press("ArrowUp")  # shows the cursor in the corner
    corner = box(page, ".draw-cursor")
    for i, (x, y) in enumerate(cells):
        page.mouse.move(corner.left + (x + 0.5) * corner.width, corner.top + (y + 0.5) * corner.height)
        if i == 0:
            page.mouse.down()
    page.mouse.up()


def test_a_map_is_drawn_and_its_file_is_worth_the_same(page: Page, shared: Tabs, tmp_path: Path) -> None:
    view(page, "Draw")
    note, score = page.locator("#map-note"), page.locator("#map-optimum")
    expect(note).to_have_text("The parcel in 22 steps")
    paint = page.get_by_role("group", name="Paint")
    expect(paint.get_by_role("radio", name="Building")).to_be_checked()
    # The last parcel stays, with a message.
    paint.get_by_text("Road").click()
    drag(page, (11, 11))
    expect(page.locator(".toast")).to_contain_text("A map needs a parcel.")
    paint.get_by_text("Move").click()
    drag(page, (11, 11), (5, 0))
    expect(note).to_have_text("The parcel in 5 steps")
    paint.get_by_text("Obstacle").click()
    drag(page, (2, 0), (2, 3))
    expect(note).to_have_text("The parcel in 13 steps")
    # With the keyboard: a second parcel below the wall. It costs no step.
    page.locator("#drawing").focus()
    keys(page, "7", "ArrowDown", "ArrowDown", "ArrowRight", "Space")
    expect(note).to_have_text("Both parcels in 13 steps")
    battery = page.get_by_role("spinbutton", name="Battery")
    enter(battery, "14")
    expect(page.locator(".draw-side .waiting")).to_have_count(0)
    shown = score.inner_text()
    with page.expect_download() as saving:
        press(page, "Save file")
    file = tmp_path / saving.value.suggested_filename
    saving.value.save_as(file)
    task = city_task(file)
    best = solve(task, 0)
    assert (task.battery_capacity, len(best.actions), points(best.score)) == (14, 13, shown)
    shared.expect("422|404")
    paint.get_by_text("Obstacle").click()
    drag(page, (2, 3), (2, 11))
    page.reload()
    problem = page.locator("#view-draw").get_by_role("alert")
    expect(problem).to_contain_text("Obstacles block every way from the start to parcel 1 [5, 0]")
    # The saved file is opened again, stored and flown.
    view(page, "Fly")
    open_file(page, file.name, file.read_text(encoding="utf-8"))
    expect(page).to_have_url(re.compile(rf"view=draw&file={file.name}~\w+$"))
    page.reload()
    expect(score).to_have_text(shown)
    press(page, "Fly it")
    expect_step(page, 0, 120)
    expect(page).to_have_url(re.compile(f"task={file.stem}&seed=0&pilot=human"))
    expect(page.locator(".plan-head")).to_have_text(f"Drawn map {file.stem[6:10]} · You")
    expect(page.get_by_role("button", name="New map")).to_be_hidden()
    page.go_back()
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    press(page, "Copy link")
    expect(page.locator("#toasts")).to_contain_text("Link copied.")
    assert page.evaluate("navigator.clipboard.readText()").endswith(f"/?task={file.stem}&seed=0&pilot=human")
    press(page, "Race")
    expect_flying(page, "Tournet", "Greedy", "Nearest neighbour", "Beam search", "Optimal", "Random", "You")
    with page.expect_response("**/maps/worth"):
        choices(page).get_by_role("link", name="Edit this map").click()
    expect(score).to_have_text(shown)
    expect(paint.get_by_role("radio", name="Move")).to_be_checked()
    # While a slow server computes, the page shows no optimum of another map.
    held: list[Route] = []
    page.route("**/maps/worth", lambda route, _: held.append(route))
    press(page, "Empty map")
    expect(score).to_have_css("opacity", "0")
    until(page, lambda: bool(held))
    held[0].continue_()
    page.unroute("**/maps/worth")
    expect(note).to_have_text("The parcel in 22 steps")
    press(page, "Undo")
    expect(score).to_have_text(shown)
    # An empty map is not replaced by one that still loads.
    loading: list[Route] = []
    page.route("**/maps/skyline_easy/7", lambda route, _: loading.append(route))
    show(page, "?view=draw&task=skyline_easy&seed=7")
    until(page, lambda: bool(loading))
    press(page, "Empty map")
    expect(note).to_have_text("The parcel in 22 steps")
    with page.expect_response("**/maps/skyline_easy/7"):
        loading[0].continue_()
    pictures(page)
    expect(page.get_by_role("spinbutton", name="Columns")).to_have_value("12")
    # An address of no map shows neither the map before nor an empty one.
    show(page, "?view=draw&task=atlantis")
    expect(problem).to_contain_text("atlantis")
    expect(score).to_have_text("–")
