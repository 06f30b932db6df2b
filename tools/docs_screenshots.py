"""Take the screenshots of the page for the docs, in half a minute.

    docs/images/dashboard-fly.png        the trained network over hard map 7
    docs/images/dashboard-narrow.png     the same on a telephone
    docs/images/dashboard-fork.png       a fork of a failed flight at the last step that could be won
    docs/images/dashboard-layers.png     the best moves from each cell of a skyline city, and the battery range
    docs/images/dashboard-several.png    four pilots on one map, their flights annotated
    docs/images/dashboard-city.png       the same over a real city
    docs/images/dashboard-compare.png    the leaderboard, and two pilots map by map
    docs/images/dashboard-draw.png       the map editor
    docs/images/dashboard-learn.png      the tutorial, and the levels side by side

The script starts a server and the installed chromium; the fonts of the machine affect the pictures.
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
from tests.browser.stage import ended, fly, view  # noqa: E402
from tests.browser.tabs import NARROW, WIDE, Tabs, find_chromium, launched  # noqa: E402

IMAGES = ROOT / "docs" / "images"
HARD = "/?task=hard&seed=7&pilot=pathqnet"
FLIGHTS = 60


def save(page: Page, name: str) -> None:
    """Save a screenshot after the animations have ended."""
    page.wait_for_timeout(700)
    taken = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    # 256 colours cut the size to a third. MAXCOVERAGE would give light grounds a pink cast.
    few = taken.quantize(256, method=Image.Quantize.MEDIANCUT, kmeans=2, dither=Image.Dither.NONE)
    few.save(IMAGES / f"dashboard-{name}.png", optimize=True)


def fly_to_the_end(page: Page) -> None:
    """Fly at the highest speed and wait for the annotations."""
    fly(page)
    ended(page)
    page.wait_for_load_state("networkidle")


def alone(tabs: Tabs) -> None:
    """One flight, wide and narrow."""
    views: tuple[tuple[str, dict[str, Any]], ...] = (
        ("fly", {"viewport": WIDE}),
        ("narrow", {"viewport": NARROW, "device_scale_factor": 2, "is_mobile": True, "has_touch": True}),
    )
    for name, options in views:
        page = tabs.open(f"{HARD}&step=22", **options)
        expect(page.locator(".live-points")).to_contain_text("still possible")
        save(page, name)


def fork(tabs: Tabs) -> None:
    """A fork before the move that Greedy fails by, over a skyline city."""
    page = tabs.open("/?task=skyline_hard&seed=7&pilot=greedy", viewport=WIDE)
    fly_to_the_end(page)
    page.locator("#again").click()
    for step in range(15, 22):
        expect(page.locator("#step-counter")).to_contain_text(f"Step {step} of")
        page.locator("#q-values tr.best button").first.click()
    expect(page.locator("#q-values tr.best").first).to_be_visible()
    save(page, "fork")


def layers(tabs: Tabs) -> None:
    """A moment over a skyline city."""
    page = tabs.open("/?task=skyline_medium&seed=43&pilot=tournet&step=24", viewport=WIDE)
    for layer in ("values", "range"):
        page.locator(f"#layer-{layer}").check()
    expect(page.locator("#q-values tr.best").first).to_be_visible()
    save(page, "layers")


def several(tabs: Tabs) -> None:
    """Four pilots, one of them selected with its moves."""
    page = tabs.open("/?task=skyline_hard&seed=7&pilots=tournet,greedy,optimal,random", viewport=WIDE)
    fly_to_the_end(page)
    page.locator("#standings").get_by_role("button", name="Greedy").click()
    page.locator("#timeline").fill("23")
    save(page, "several")


def city(tabs: Tabs) -> None:
    """Four pilots over Helsinki."""
    page = tabs.open("/?task=city&seed=7&pilots=tournet,greedy,optimal,random", viewport=WIDE)
    fly_to_the_end(page)
    page.locator("#timeline").fill("140")
    save(page, "city")


def pages(tabs: Tabs) -> None:
    """Compare and Learn."""
    page = tabs.open("/?view=compare&task=skyline_medium&pilots=tournet,greedy", viewport=WIDE)
    expect(page.get_by_role("heading", name="Tournet against Greedy")).to_be_visible()
    page.wait_for_load_state("networkidle")
    save(page, "compare")
    view(page, "Learn")
    expect(page.locator(".lesson").first).to_be_visible()
    save(page, "learn")


def drawing(tabs: Tabs) -> None:
    """A skyline city in the editor."""
    page = tabs.open("/?view=draw&task=skyline_medium&seed=43", viewport=WIDE)
    expect(page.locator("#map-note")).to_contain_text("steps")
    save(page, "draw")


def main() -> None:
    """Take all screenshots."""
    expect.set_options(timeout=60_000)
    chromium = find_chromium()
    if chromium is None:
        raise SystemExit("chromium is not installed: apt-get install chromium")
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        agents = ("random", "tournet", "greedy")
        fill(data, [flown("skyline_medium", seed, agent) for seed in range(FLIGHTS // len(agents)) for agent in agents])
        with serving(data) as server, launched(chromium) as browser:
            tabs = Tabs(browser, server.url)
            for take in (alone, fork, layers, several, city, drawing, pages):
                take(tabs)
            if tabs.complaints:
                raise SystemExit("\n".join(["the page complained:", *tabs.complaints]))
    for image in sorted(IMAGES.glob("dashboard-*.png")):
        print(f"{image.relative_to(ROOT)}  {image.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
