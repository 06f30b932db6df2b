"""Take the pictures of the dashboard: `make screenshots`, half a minute.

    docs/images/dashboard-watch.png          the trained network over hard map 7
    docs/images/dashboard-watch-light.png    the same in light colours
    docs/images/dashboard-skyline.png        a best flight over a skyline city
    docs/images/dashboard-results.png        the Mission Results
    docs/images/dashboard-race.png           four pilots on one map
    docs/images/dashboard-replay.png         a flight annotated move by move
    docs/images/dashboard-history.png        episodes and charts
    docs/images/dashboard-learn.png          the tutorial, and the levels side by side
    docs/images/dashboard-narrow.png         on a telephone

Server, flights and the machine's own chromium are real; the pictures depend on its fonts a little.
"""

import io
import sys
import tempfile
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import Page, expect

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.api.serving import serving  # noqa: E402
from tests.browser.flights import fill, flown  # noqa: E402
from tests.browser.stage import fastest, fly, results, view  # noqa: E402
from tests.browser.tabs import NARROW, Tabs, find_chromium, launched  # noqa: E402

IMAGES = ROOT / "docs" / "images"
HARD = "/?task=hard&seed=7&pilot=pathqnet"
FLIGHTS = 60


def save(page: Page, name: str) -> None:
    """The picture of what is in the window, once nothing moves but the drones."""
    page.wait_for_timeout(700)
    taken = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    # 256 colours of the page's few: a third of the size, and nobody sees it.
    taken.quantize(256, dither=Image.Dither.NONE).save(IMAGES / f"dashboard-{name}.png", optimize=True)


def steps(page: Page, number: int) -> None:
    """Fly some steps, one at a time."""
    for step in range(1, number + 1):
        page.get_by_role("button", name="Step", exact=True).click()
        expect(page.locator("#step-counter")).to_contain_text(f"Step {step} of")


def watch(tabs: Tabs) -> None:
    """The main view, dark, light and narrow, and over a skyline city."""
    views: tuple[tuple[str, dict[str, Any]], ...] = (
        ("watch", {}),
        ("watch-light", {"color_scheme": "light"}),
        ("narrow", {"viewport": NARROW, "device_scale_factor": 2, "is_mobile": True, "has_touch": True}),
    )
    for name, options in views:
        page = tabs.open(HARD, **options)
        expect(page.locator("#possible")).not_to_have_text("–")
        steps(page, 22)
        save(page, name)
    page = tabs.open("/?task=skyline_medium&seed=7&pilot=optimal")
    steps(page, 30)
    save(page, "skyline")


def outcome(tabs: Tabs) -> None:
    """The results of a mission."""
    page = tabs.open(HARD)
    page.evaluate("localStorage.setItem('drone-env-cycle', 'off')")
    fly(page)
    expect(results(page).get_by_text("Success rate")).to_be_visible()
    save(page, "results")


def race(tabs: Tabs) -> None:
    """Four pilots, one of them selected with its moves."""
    page = tabs.open("/?task=hard&seed=7&pilots=pathqnet,greedy,optimal,random")
    fastest(page)
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.get_by_role("button", name="Fly again")).to_be_visible()
    page.locator("#standings").get_by_role("button", name="Greedy").click()
    expect(page.get_by_role("button", name="Step 1, ")).to_be_visible()
    # The other flights are annotated meanwhile.
    page.wait_for_timeout(2000)
    save(page, "race")


def past(tabs: Tabs) -> None:
    """A replay, the history, Learn."""
    page = tabs.open("/#history")
    page.get_by_role("combobox", name="Task").select_option("medium")
    expect(page.get_by_role("figure").locator("canvas").last).to_be_visible()
    save(page, "history")
    view(page, "Learn")
    expect(page.locator(".lesson").first).to_be_visible()
    save(page, "learn")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "flight.json"
        file.write_text(flown("medium", 7, "random").to_json(), encoding="utf-8")
        view(page, "Replay")
        page.get_by_label("Open a file…").set_input_files(file)
        page.locator(".replay-moves").get_by_role("button", name="blunder").first.click()
    save(page, "replay")


def main() -> None:
    """Take them all."""
    expect.set_options(timeout=60_000)
    chromium = find_chromium()
    if chromium is None:
        raise SystemExit("chromium is not installed: apt-get install chromium")
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        agents = ("random", "pathqnet", "greedy")
        fill(data, [flown("medium", seed, agents[seed % len(agents)]) for seed in range(FLIGHTS)])
        with serving(data) as server, launched(chromium) as browser:
            tabs = Tabs(browser, server.url)
            for take in (watch, outcome, race, past):
                take(tabs)
            tabs.close()
            if tabs.complaints:
                raise SystemExit("\n".join(["the page complained:", *tabs.complaints]))
    for image in sorted(IMAGES.glob("dashboard-*.png")):
        print(f"{image.relative_to(ROOT)}  {image.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
