"""Draw: a map is painted, its optimum follows, and its file is worth the same everywhere else."""

from pathlib import Path

import gymnasium
import pytest
from playwright.sync_api import Page, expect

from drone_env.city.city_task import city_task
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
    drag(page, (2, 0), (2, 3))
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
