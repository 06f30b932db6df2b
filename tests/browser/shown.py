"""What the page shows: numbers as it writes them, its instruments, and the pixels of its canvases."""

import re
from decimal import ROUND_HALF_UP, Decimal
from typing import Any, NamedTuple

from playwright.sync_api import Locator, Page, Position, expect


def fixed(value: float, digits: int = 2) -> str:
    """A number as the page writes it: rounds half up, as browsers do, with the minus sign of typography."""
    rounded = Decimal(value).quantize(Decimal(1).scaleb(-digits), ROUND_HALF_UP)
    return str(rounded).replace("-", "\u2212")


def points(score: float, digits: int = 1) -> str:
    """A score as the page writes it, times 100."""
    return fixed(score * 100, digits)


def lost(optimum: float, score: float) -> str:
    """The points between two scores as the page writes them: of the rounded scores, so that all add up."""
    return str(Decimal(points(optimum)) - Decimal(points(score)))


def percent(share: float) -> str:
    """A share as the page writes it."""
    return f"{fixed(share * 100, 0)} %"


def counter(page: Page) -> int:
    """The step that is shown."""
    return int(page.locator("#step-counter").inner_text().split()[1])


def measured(page: Page, selector: str, expression: str) -> list[Any]:
    """What a script makes of each element as `one`, found and measured in one call.

    A locator finds first, and the page may draw the elements again before it measures them.
    """
    return page.evaluate(f"selector => [...document.querySelectorAll(selector)].map(one => {expression})", selector)


class Box(NamedTuple):
    """Where an element is in the window."""

    left: float
    top: float
    width: float
    height: float


def box(page: Page, selector: str) -> Box:
    """The place of the one visible element of a selector."""
    sides = "(({ x, y, width, height }) => [x, y, width, height])(one.getBoundingClientRect())"
    (found,) = (Box(*one) for one in measured(page, selector, sides) if one[2])
    return found


def at(node: Locator, across: float, down: float = 0.5) -> Position:
    """A place on an element, by shares of its width and height."""
    width, height = node.evaluate("node => [node.clientWidth, node.clientHeight]")
    return {"x": across * width, "y": down * height}


def expect_step(page: Page, step: int, most: int, action: str = "") -> None:
    """The counter shows this step of a flight, and the action that led to it."""
    text = f"Step {step} of {most}" + (f" · {action}" if action else "")
    expect(page.locator("#step-counter")).to_have_text(re.compile(rf"^{text}\b"))


def expect_flying(page: Page, *names: str) -> None:
    expect(page.locator(".pilot-name[aria-pressed=true]")).to_have_text(names)


def expect_frame(page: Page, frame: dict[str, Any], capacity: int) -> None:
    """The instruments show this frame."""
    expect(page.locator("#step-counter")).to_have_text(re.compile(rf"^Step {frame['step']} of "))
    if frame["done"]:
        expect(page.locator(".live-points [data-kind=won] strong")).to_have_text(points(frame["score"]))
    expect(page.locator("#battery")).to_contain_text(f"{frame['battery_units']} of {capacity}")
    expect(page.locator("#reward-total")).to_have_text(fixed(frame["reward_total"]))
    expect(page.locator("#efficiency")).to_have_text(fixed(frame["efficiency"], 1))
    if frame["step"]:
        expect(page.locator("#reward")).to_have_text(f"+{fixed(frame['reward'], 3)}")
    if frame["target"]:
        expect(page.locator("#target")).to_contain_text(f"[{frame['target'][0]}, {frame['target'][1]}]")


def pictures(page: Page) -> list[str]:
    """The canvases of the maps as data URLs: for each map the city, the layers of its cells, what moves.

    The page draws in the next frame, and again once the fonts are loaded.
    """
    return page.evaluate(
        """async () => {
            await document.fonts.ready;
            for (let frame = 0; frame < 2; frame++) await new Promise(requestAnimationFrame);
            return [...document.querySelectorAll("#boards canvas")].map(canvas => canvas.toDataURL());
        }"""
    )


def changed(page: Page, before: list[str]) -> list[int]:
    """The canvases of the maps that differ from earlier pictures."""
    return [place for place, (now, then) in enumerate(zip(pictures(page), before, strict=True)) if now != then]


def notes(page: Page) -> list[list[str]]:
    """The lines of each note that a pointer brings up as it crosses the map."""
    texts: list[str] = page.evaluate(
        """() => {
            const map = document.querySelector("#boards .map-air"), note = document.querySelector(".cell-note");
            const { x, y, width, height } = map.getBoundingClientRect();
            const said = new Set();
            for (let place = 0; place < 256; place++) {
                const [clientX, clientY] = [x + (width * (place % 16)) / 16, y + (height * (place >> 4)) / 16];
                const moved = { pointerType: "mouse", bubbles: true, clientX, clientY };
                map.dispatchEvent(new PointerEvent("pointermove", moved));
                if (!note.hidden) said.add(note.innerText);
            }
            return [...said];
        }"""
    )
    return [text.split("\n") for text in texts]


def painted(canvas: Locator, *names: str) -> list[str]:
    """Those of some colours of the style sheet that a canvas shows."""
    return canvas.evaluate(
        """async (canvas, names) => {
            for (let frame = 0; frame < 2; frame++) await new Promise(requestAnimationFrame);
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
