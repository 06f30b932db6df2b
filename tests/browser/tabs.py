"""Tabs of a real browser that collect what their pages complain of."""

import re
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import Browser, ConsoleMessage, Page, Response, sync_playwright

WIDE = {"width": 1440, "height": 900}
SMALL = {"width": 1120, "height": 700}
"""The smallest window with the wide layout: each cell that is drawn costs CPU time."""
NARROW = {"width": 390, "height": 844}
PATIENCE_MS = 60_000
"""How long to wait for an expectation about a page: long, because only a failing test waits that long."""
# Containers have little /dev/shm and run as root.
FLAGS = ["--no-sandbox", "--disable-dev-shm-usage"]


def find_chromium() -> str | None:
    """Path of the machine's own chromium. Nothing is ever downloaded."""
    return shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@contextmanager
def launched(path: str) -> Generator[Browser, None, None]:
    """A browser without a window."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=FLAGS)
        try:
            yield browser
        finally:
            browser.close()


class Tabs:
    """Opens pages, each in a context of its own as if in another browser, and collects their complaints.

    A complaint is an error or a warning on the console (a violation of the content security policy is one), an
    uncaught error, and a response with status 400 or above. That a preloaded file is used late is none: it depends on
    how busy the machine is.

    Args:
        browser: Where to open them.
        url: The base of the paths.
    """

    def __init__(self, browser: Browser, url: str) -> None:
        self.browser = browser
        self.url = url
        self.complaints: list[str] = []
        self.expected: list[str] = []

    def open(self, path: str = "", beside: Page | None = None, **options: Any) -> Page:
        """A page in a fresh context, or in that of another page; it opens `path`, if there is one."""
        if beside:
            context = beside.context
        else:
            # Without motion a map is drawn once a step, not sixty times a second.
            usual = {"viewport": SMALL, "color_scheme": "dark", "reduced_motion": "reduce"}
            context = self.browser.new_context(base_url=self.url, **{**usual, **options})
            context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        page.on("console", self._on_console)
        page.on("pageerror", lambda error: self.complaints.append(f"uncaught: {error}"))
        page.on("response", self._on_response)
        if path:
            page.goto(path)
        return page

    def expect(self, pattern: str) -> None:
        """Complaints that match are what the test causes itself."""
        self.expected.append(pattern)

    def unexpected(self) -> list[str]:
        """The complaints since the last call that no test expects."""
        found = [text for text in self.complaints if not any(re.search(known, text) for known in self.expected)]
        self.complaints.clear()
        self.expected.clear()
        return found

    def _on_console(self, message: ConsoleMessage) -> None:
        if (
            message.type in ("error", "warning")
            and "preloaded using link preload but not used within a few seconds" not in message.text
        ):
            self.complaints.append(f"console {message.type}: {message.text} ({message.location.get('url', '')})")

    def _on_response(self, response: Response) -> None:
        if response.status >= 400:
            self.complaints.append(f"answer {response.status}: {response.request.method} {response.url}")
