"""Measure the page: CPU time per frame while pilots fly, first paint and size.

    python benchmarks/dashboard.py [--seconds 10] [--speed 6] [--visits 10] [--json FILE]

It measures four pilots over hard map 7 and over the task `city` (Helsinki, 64 x 64 cells), the city also zoomed in
while the map follows the drone.

The script starts a server and the installed chromium without a window. The browser's trace contains the time between
two animation frames and the script time of each: the CPU time of the main thread in JavaScript (animation callbacks,
socket messages, timers) until the next frame. The first paint is measured with an empty cache.
"""

import argparse
import json
import re
import statistics
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, expect

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.api.serving import serving  # noqa: E402
from tests.browser.tabs import WIDE, find_chromium, launched  # noqa: E402

FOUR = "/?task=hard&seed=7&pilots=pathqnet,greedy,optimal,random"
CITY = "/?task=city&seed=7&pilots=optimal,greedy,tournet,random"
SCRIPT = {
    "FireAnimationFrame",
    "FunctionCall",
    "EvaluateScript",
    "RunMicrotasks",
    "TimerFire",
    "EventDispatch",
    "v8.run",
}
CATEGORIES = ["devtools.timeline", "v8.execute", "disabled-by-default-devtools.timeline"]
KILOBYTE = 1000


def percentiles(values: Sequence[float]) -> dict[str, float]:
    """p50, p95, p99 and maximum."""
    cuts = statistics.quantiles(values, n=100, method="inclusive")
    return {"p50": cuts[49], "p95": cuts[94], "p99": cuts[98], "max": max(values)}


def main_thread(trace: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The complete events of the main thread, sorted by start."""
    frames = [event for event in trace if event.get("name") == "FireAnimationFrame"]
    if not frames:
        raise SystemExit("the page drew no frame")
    key = (frames[0]["pid"], frames[0]["tid"])
    own = [event for event in trace if (event.get("pid"), event.get("tid")) == key and event.get("ph") == "X"]
    return sorted(own, key=lambda event: event["ts"])


def script_spans(events: list[dict[str, Any]]) -> Iterator[tuple[float, float]]:
    """(start, CPU time) in microseconds of each script call, without nested calls."""
    end = -1.0
    for event in events:
        if event["name"] in SCRIPT and event["ts"] >= end:
            end = event["ts"] + event["dur"]
            # The trace has no CPU time for a few short calls.
            yield event["ts"], event.get("tdur", event["dur"])


def frame_costs(trace: list[dict[str, Any]]) -> tuple[list[float], list[float]]:
    """The time between frames and the script time of each, in ms."""
    events = main_thread(trace)
    # One frame may fire several callbacks within a fraction of a millisecond.
    starts = [event["ts"] for event in events if event["name"] == "FireAnimationFrame"]
    frames = [start for before, start in zip([float("-inf"), *starts], starts, strict=False) if start - before > 4000]
    spans = list(script_spans(events))
    costs: list[float] = []
    at = 0
    for frame, following in pairwise(frames):
        cost = 0.0
        while at < len(spans) and spans[at][0] < following:
            if spans[at][0] >= frame:
                cost += spans[at][1]
            at += 1
        costs.append(cost / 1000)
    return [(b - a) / 1000 for a, b in pairwise(frames)], costs


def hard(page: Page) -> None:
    """Four pilots over a small map."""
    page.goto(FOUR)


def city(page: Page) -> None:
    """Four pilots over a real city."""
    page.goto(CITY)


def city_zoomed(page: Page) -> None:
    """The same, zoomed in: the map moves with the drone."""
    city(page)
    expect(page.locator("#start")).to_be_enabled()
    for _ in range(2):
        page.get_by_role("button", name="Zoom in").click()


def flying(
    browser: Browser, url: str, opened: Callable[[Page], None], seconds: float, speed: str
) -> tuple[list[float], list[float]]:
    """Frame costs while pilots fly on the page that `opened` opens."""
    context = browser.new_context(base_url=url, viewport=WIDE)  # type: ignore[arg-type]
    page = context.new_page()
    opened(page)
    page.get_by_role("combobox", name="Speed").select_option(speed)
    page.get_by_role("button", name="Start", exact=True).click()
    # The optimal pilot may need time to plan.
    begun = re.compile(r"Step ([3-9]|\d\d) of")
    expect(page.locator("#step-counter")).to_contain_text(begun, timeout=60_000)
    browser.start_tracing(page=page, categories=CATEGORIES)
    page.wait_for_timeout(seconds * 1000)
    trace = json.loads(browser.stop_tracing())["traceEvents"]
    context.close()
    return frame_costs(trace)


def visit(browser: Browser, url: str) -> tuple[float, float, int, int]:
    """First paint and first contentful paint in ms, files and bytes of one visit with an empty cache."""
    context = browser.new_context(base_url=url, viewport=WIDE)  # type: ignore[arg-type]
    page = context.new_page()
    page.goto("/")
    expect(page.locator("#step-counter")).to_contain_text("Step 0")
    paints = page.evaluate("Object.fromEntries(performance.getEntriesByType('paint').map(e => [e.name, e.startTime]))")
    sizes: dict[str, int] = page.evaluate(
        """() => {
            const loaded = ["navigation", "resource"].flatMap(type => performance.getEntriesByType(type));
            const files = loaded.filter(({ name }) => /\\/static\\/|\\/$/.test(name));
            return Object.fromEntries(files.map(file => [file.name, file.encodedBodySize]));
        }"""
    )
    context.close()
    return paints["first-paint"], paints["first-contentful-paint"], len(sizes), sum(sizes.values())


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10, help="seconds of flight per case")
    parser.add_argument("--speed", default="6", help="steps per second, one of the choices of the page")
    parser.add_argument("--visits", type=int, default=10, help="number of visits with an empty cache")
    parser.add_argument("--json", type=Path, help="also write the results to this file")
    given = parser.parse_args()
    chromium = find_chromium()
    if chromium is None:
        raise SystemExit("chromium is not installed: apt-get install chromium")
    with (
        tempfile.TemporaryDirectory() as folder,
        serving(Path(folder) / "data") as server,
        launched(chromium) as browser,
    ):
        frames: dict[str, dict[str, Any]] = {}
        for opened in (hard, city, city_zoomed):
            intervals, scripts = flying(browser, server.url, opened, given.seconds, given.speed)
            costs = {"frame_ms": percentiles(intervals), "script_ms": percentiles(scripts)}
            frames[opened.__name__] = {"frames": len(intervals), **costs}
        visits = [visit(browser, server.url) for _ in range(given.visits)]
        version = browser.version
    report = {
        "chromium": version,
        **frames,
        "first_paint_ms": percentiles([paint for paint, _, _, _ in visits]),
        "first_contentful_paint_ms": percentiles([paint for _, paint, _, _ in visits]),
        "files": visits[0][2],
        "kilobytes": visits[0][3] / KILOBYTE,
    }
    print(json.dumps(report, indent=2))
    if given.json:
        given.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
