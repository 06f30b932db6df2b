"""Tabs of a real browser that keep whatever their pages complain of."""

import re
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, Response, sync_playwright
from typing_extensions import Self

from tests.tools import missing_tool

WIDE = {"width": 1440, "height": 900}
SMALL = {"width": 1120, "height": 700}
"""As small as the wide layout gets: each cell that is drawn costs the processor."""
NARROW = {"width": 390, "height": 844}
PATIENCE_MS = 60_000
"""How long a page may take to come to what is expected: long, since nobody waits for it where all is well."""
# Containers have little /dev/shm and run as root.
FLAGS = ["--no-sandbox", "--disable-dev-shm-usage"]
SHORT_LIVED = "--js-flags=--no-opt --no-maglev"
"""For pages that do not live long enough for optimised code to pay."""


def find_chromium() -> str | None:
    """Path of the machine's own chromium. None is ever downloaded."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@contextmanager
def launched(path: str, *flags: str) -> Generator[Browser, None, None]:
    """A browser without a window."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=[*FLAGS, *flags])
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def needed_browser() -> Generator[Browser, None, None]:
    """The same of the machine's own chromium; a test that finds none is skipped, or fails."""
    with launched(find_chromium() or missing_tool("chromium"), SHORT_LIVED) as browser:
        yield browser


class Tabs:
    """Opens pages, each in a context of its own as if in another browser, and collects their complaints.

    A complaint is an error or a warning on the console (a violation of the content security policy is one), an error
    that nobody caught, and an answer of the server of 400 or above.

    Args:
        browser: Where to open them.
        url: What the paths are relative to.
    """

    def __init__(self, browser: Browser, url: str) -> None:
        self.browser = browser
        self.url = url
        self.complaints: list[str] = []
        self._expected: list[re.Pattern[str]] = []
        self._contexts: list[BrowserContext] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def open(self, path: str = "/", go: bool = True, beside: Page | None = None, **options: Any) -> Page:
        """A page in a fresh context, or in that of another page; `path` is opened in it unless told not to."""
        context = self._new_context(**options) if beside is None else beside.context
        page = context.new_page()
        page.on("console", self._on_console)
        page.on("pageerror", lambda error: self.complaints.append(f"uncaught: {error}"))
        page.on("response", self._on_response)
        if go:
            page.goto(path)
        return page

    def _new_context(self, **options: Any) -> BrowserContext:
        options.setdefault("viewport", SMALL)
        options.setdefault("color_scheme", "dark")
        options.setdefault("reduced_motion", "no-preference")
        context = self.browser.new_context(base_url=self.url, **options)
        context.set_default_timeout(PATIENCE_MS)
        self._contexts.append(context)
        return context

    def expect(self, pattern: str) -> None:
        """Complaints that match are what the test brings about itself."""
        self._expected.append(re.compile(pattern))

    def forget(self) -> None:
        """Begin anew, for another test."""
        self.complaints.clear()
        self._expected.clear()

    def unexpected(self) -> list[str]:
        """What the pages complained of, less what was to be expected."""
        return [text for text in self.complaints if not any(known.search(text) for known in self._expected)]

    def close(self) -> None:
        """Close all pages."""
        for context in self._contexts:
            context.close()

    def _on_console(self, message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            self.complaints.append(f"console {message.type}: {message.text} ({message.location.get('url', '')})")

    def _on_response(self, response: Response) -> None:
        if response.status >= 400:
            self.complaints.append(f"answer {response.status}: {response.request.method} {response.url}")
