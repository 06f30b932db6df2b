"""Actions of a visitor on the page, and the elements that tests look for."""

import time
from collections.abc import Callable

from playwright.sync_api import Locator, Page, expect

from tests.browser.tabs import PATIENCE_MS

FASTEST = "60"
"""Steps per second, the last choice."""


def view(page: Page, name: str) -> None:
    """Open a view by its link in the navigation."""
    page.get_by_role("navigation", name="Views").get_by_role("link", name=name, exact=True).click()


def show(page: Page, path: str) -> None:
    """Go to an address as Back and Forward do: the page stays loaded, which costs less than `goto`."""
    page.evaluate("path => { history.pushState(null, '', path); dispatchEvent(new PopStateEvent('popstate')); }", path)


def until(page: Page, holds: Callable[[], bool]) -> None:
    """Wait until something holds that `expect` cannot look at."""
    deadline = time.monotonic() + PATIENCE_MS / 1000
    while not holds():
        assert time.monotonic() < deadline
        # Not `sleep`: Playwright calls no handlers while the test sleeps.
        page.wait_for_timeout(20)


def slider(page: Page) -> Locator:
    return page.get_by_role("slider", name="Step of the flight")


def choices(page: Page) -> Locator:
    """The choices above the map, once they are open: pilots and map."""
    opened = page.locator(".plan-details")
    opened.evaluate("details => { details.open = true; }")
    return opened


def map_number(page: Page) -> Locator:
    return page.locator("#seed")


def task(page: Page, name: str) -> Locator:
    """The button of a task above the map."""
    return page.get_by_role("navigation", name="Tasks").get_by_role("button", name=name, exact=True)


def expect_task(page: Page, name: str) -> None:
    """This task is flown."""
    expect(task(page, name)).to_have_attribute("aria-pressed", "true")


def moves(page: Page) -> Locator:
    return page.get_by_role("list", name="Moves").get_by_role("button")


def standings(page: Page) -> Locator:
    return page.locator("#standings tbody tr")


def open_file(page: Page, name: str, text: str) -> None:
    """Choose a file in a field of the page."""
    page.locator("#flight-file").set_input_files({"name": name, "mimeType": "text/plain", "buffer": text.encode()})


def over(page: Page, seed: int, path: str) -> None:
    """Go to a flight over a map of this number, and wait until the page shows it."""
    drawn = page.locator("#boards [role=img]").first.get_attribute("aria-label") or ""
    if f"map {seed}," in drawn:
        # If it is the flight that is shown already, the page would not restart it.
        over(page, seed + 1, f"/?task=easy&seed={seed + 1}&pilot=greedy")
    show(page, path)
    expect(page.get_by_role("img", name=f"map {seed},").first).to_be_visible()


def at_its_end(page: Page, seed: int, path: str) -> Locator:
    """Go to the end of a flight, which costs less than to watch each step; its results."""
    over(page, seed, f"{path}&step=999")
    return ended(page)


def at_speed(page: Page, steps: str) -> None:
    """Choose the steps per second, as the choices are written."""
    page.get_by_role("combobox", name="Speed").select_option(steps)


def press(page: Page, button: str) -> None:
    page.get_by_role("button", name=button, exact=True).click()


def keys(page: Page, *names: str) -> None:
    """Press keys one after another."""
    for name in names:
        page.keyboard.press(name)


def enter(field: Locator, text: str) -> None:
    """Write into a field, and confirm it."""
    field.fill(text)
    field.press("Enter")


def fly(page: Page, button: str = "Start") -> None:
    """Start, or go on, at the highest speed."""
    at_speed(page, FASTEST)
    press(page, button)


def ended(page: Page) -> Locator:
    """Mission Results, once the flight has ended and is annotated."""
    card = page.locator(".results")
    expect(card).to_be_visible()  # a hidden card may be that of the flight before
    expect(card).to_contain_text("possible")
    expect(card).not_to_contain_text("Comparing this flight")
    return card


def pilot(page: Page, name: str) -> Locator:
    """The button that makes a pilot fly alone."""
    return choices(page).get_by_role("group", name="Pilots").get_by_role("button", name=name, exact=True)


def along(page: Page, name: str) -> Locator:
    """The box that makes a pilot fly along."""
    return choices(page).get_by_role("checkbox", name=f"Add {name}", exact=True)
