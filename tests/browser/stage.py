"""What a person does on the stage of the page, and what stands there."""

import re
from decimal import ROUND_HALF_UP, Decimal
from typing import Any

from playwright.sync_api import Locator, Page, expect

from drone_env.results.record import EpisodeRecord

FASTEST = "60"
"""Steps per second, the last choice."""
SIGNS = {
    "Fly": "#boards .map",
    "Compare": "#view-compare tbody tr",
    "Learn": ".lesson",
    "API": "#log-requests li",
}
"""What stands in a view once it has all that it shows."""


def view(page: Page, name: str) -> None:
    """Go to a view by its link above."""
    page.get_by_role("navigation", name="Views").get_by_role("link", name=name, exact=True).click()


def whole_view(page: Page, name: str) -> None:
    """The same, and wait for what it shows."""
    view(page, name)
    expect(page.locator(SIGNS[name]).first).to_be_visible()


def show(page: Page, path: str) -> None:
    """Go to an address of the page as Back and Forward do: what is loaded stays, which costs less than `goto`."""
    page.evaluate("path => { history.pushState(null, '', path); dispatchEvent(new PopStateEvent('popstate')); }", path)


def slider(page: Page) -> Locator:
    return page.get_by_role("slider", name="Step of the flight")


def dropped(page: Page, name: str, text: str) -> None:
    """Drop a file on the page."""
    transfer = page.evaluate_handle(
        "([name, text]) => { const t = new DataTransfer(); t.items.add(new File([text], name)); return t; }",
        [name, text],
    )
    for event in ("dragover", "drop"):
        page.dispatch_event("main", event, {"dataTransfer": transfer})


def opened(page: Page, record: EpisodeRecord) -> None:
    """Drop a record on the page, and wait until it stands there."""
    dropped(page, "flight.json", record.to_json(2))
    expect(page.locator(".strip")).to_contain_text(f"{record.agent}: ")
    expect(page.get_by_role("spinbutton", name="Map")).to_have_value(str(record.seed))
    expect(slider(page)).to_have_attribute("max", str(len(record.actions)))


def over(page: Page, seed: int, path: str) -> None:
    """The same, to a flight over a map of this number, and wait until it is the one that is shown."""
    drawn = page.locator("#boards [role=img]").first.get_attribute("aria-label") or ""
    if f"map {seed}," in drawn:
        # It may be that very flight, somewhere on its way: the page would not begin it anew.
        over(page, seed + 1, f"/?task=easy&seed={seed + 1}&pilot=greedy")
    show(page, path)
    expect(page.get_by_role("img", name=f"map {seed},").first).to_be_visible()


def at_its_end(page: Page, seed: int, path: str) -> Locator:
    """The same of a flight that is flown to its end at once, which costs less than to see each step; its strip."""
    over(page, seed, f"{path}&step=999")
    return ended(page)


def at_speed(page: Page, steps: str) -> None:
    """So many steps per second, as the choices are written."""
    page.get_by_role("combobox", name="Speed").select_option(steps)


def fly(page: Page, button: str = "Start") -> None:
    """Start, or go on, as fast as it goes."""
    at_speed(page, FASTEST)
    page.get_by_role("button", name=button, exact=True).click()


def ended(page: Page) -> Locator:
    """The strip below the map that says how the flight went, once it has ended and is annotated."""
    strip = page.locator(".strip")
    expect(strip).to_be_visible()  # what is hidden there may be of the flight before
    expect(strip).to_contain_text("a best flight takes")
    return strip


def step(page: Page) -> None:
    """One step forward."""
    page.get_by_role("button", name="Step", exact=True).click()


def pilot(page: Page, name: str) -> Locator:
    """The button that has a pilot fly alone."""
    return page.get_by_role("group", name="Pilots").get_by_role("button", name=name, exact=True)


def along(page: Page, name: str) -> Locator:
    """The box that has a pilot fly along."""
    return page.get_by_role("checkbox", name=f"{name} flies along", exact=True)


def counter(page: Page) -> int:
    """The step that is shown."""
    text = page.locator("#step-counter").inner_text()
    found = re.match(r"Step (\d+) of \d+", text)
    assert found, f"no step in {text!r}"
    return int(found[1])


def fixed(value: float, digits: int = 2) -> str:
    """A number as the page writes it: a half is rounded up, as browsers do, and minus is a sign of its own."""
    rounded = Decimal(value).quantize(Decimal(1).scaleb(-digits), ROUND_HALF_UP)
    return str(rounded).replace("-", "\u2212")


def points(score: float, digits: int = 1) -> str:
    """A score as the page writes it, times 100."""
    return fixed(score * 100, digits)


def expect_frame(page: Page, frame: dict[str, Any], capacity: int) -> None:
    """The instruments show this frame."""
    expect(page.locator("#step-counter")).to_have_text(re.compile(rf"^Step {frame['step']} of "))
    expect(page.locator("#score")).to_have_text(points(frame["score"]))
    expect(page.locator("#battery")).to_contain_text(f"{frame['battery_units']} of {capacity}")
    expect(page.locator("#reward-total")).to_have_text(fixed(frame["reward_total"]))
    expect(page.locator("#efficiency")).to_have_text(fixed(frame["efficiency"], 1))
    if frame["step"]:
        expect(page.locator("#reward")).to_have_text(f"+{fixed(frame['reward'], 3)}")
    if frame["target"]:
        expect(page.locator("#target")).to_contain_text(f"[{frame['target'][0]}, {frame['target'][1]}]")


def pictures(page: Page) -> list[str]:
    """What stands on the canvases of the maps, as data URLs: of each map the city, what is known of its cells,
    what moves.

    What is asked to be drawn is drawn in the next frame, and anew once the fonts are there.
    """
    return page.evaluate(
        """async () => {
            await document.fonts.ready;
            for (let frame = 0; frame < 2; frame++) await new Promise(requestAnimationFrame);
            return [...document.querySelectorAll("#boards canvas")].map(canvas => canvas.toDataURL());
        }"""
    )


def painted(canvas: Locator, *names: str) -> list[str]:
    """Those of some colours of the style sheet that stand on a canvas."""
    return canvas.evaluate(
        """async (canvas, names) => {
            await new Promise(requestAnimationFrame);
            const { width, height } = canvas;
            const picture = (...size) => new OffscreenCanvas(...size).getContext("2d", { willReadFrequently: true });
            const copy = picture(width, height);
            copy.drawImage(canvas, 0, 0);
            const there = new Set(new Uint32Array(copy.getImageData(0, 0, width, height).data.buffer));
            const pen = picture(1, 1);
            const style = getComputedStyle(document.documentElement);
            return names.filter(name => {
                pen.fillStyle = style.getPropertyValue(name);
                pen.fillRect(0, 0, 1, 1);
                return there.has(new Uint32Array(pen.getImageData(0, 0, 1, 1).data.buffer)[0]);
            });
        }""",
        list(names),
    )


def percent(share: float) -> str:
    """A share as the page writes it."""
    return f"{fixed(share * 100, 0)} %"
