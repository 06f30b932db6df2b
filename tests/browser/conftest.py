"""One browser, one server with a history and one page per process; a complaint of the page fails the test."""

import shutil
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.api.serving import Server, serving
from tests.browser.flights import fill, flown, put_evaluation
from tests.browser.stage import show
from tests.browser.tabs import PATIENCE_MS, Tabs, find_chromium, launched
from tests.llm.stored_run import put_run
from tests.tools import missing_tool

expect.set_options(timeout=PATIENCE_MS)
MARKUP = '<img src=x onerror="document.title=1"><b>bold</b>'
"""Text that must never become elements."""
SEEDS = 12
TRAINING = [
    "episode=1 reward=3.2500 success=0.000 validation=- optimum=0.9500",
    f"warning: {MARKUP}",
    "episode=3 reward=4.7500 success=0.500 validation=0.5000 optimum=0.9500",
]


# Of the package, not of the session: while Playwright runs, no other test of this process can run an event loop.
@pytest.fixture(scope="package")
def browser() -> Generator[Browser, None, None]:
    # The build without windows takes a third less CPU.
    with launched(shutil.which("chromium-headless-shell") or find_chromium() or missing_tool("chromium")) as running:
        yield running


@pytest.fixture(scope="package")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data folder of the server: easy flights, a run of a language model and an evaluation over the same maps, and
    a training log."""
    folder = tmp_path_factory.mktemp("served") / "data"
    flights = [flown("easy", seed, agent) for seed in range(SEEDS) for agent in ("random", "greedy")]
    fill(folder, [*flights, flown("medium", 3, "greedy"), flown("easy", SEEDS, "random", label=MARKUP)])
    put_run(folder, "run", "greedy", range(14, 16))
    put_evaluation(folder, "flown", "random", range(14, 16))
    (folder / "train.log").write_text("\n".join(TRAINING) + "\n", encoding="utf-8")
    return folder


@pytest.fixture(scope="package")
def server(data: Path) -> Generator[Server, None, None]:
    with serving(data) as running:
        yield running


@pytest.fixture(scope="package")
def shared(browser: Browser, server: Server) -> Tabs:
    """The tabs of `page`; a test names the complaints that it causes itself."""
    return Tabs(browser, server.url)


@pytest.fixture(scope="package")
def loaded(shared: Tabs) -> Page:
    page = shared.open("/?view=learn")
    # A page that has not loaded its code yet ignores a file that is dropped on it.
    expect(page.get_by_role("heading", name="Learn", exact=True, level=2)).to_be_visible()
    return page


@contextmanager
def lent(page: Page, tabs: Tabs) -> Generator[Page, None, None]:
    """A page that other tests have used: loading one takes longer than most tests."""
    tabs.unexpected()  # what came too late for the test before
    # Without a next task that starts by itself while a test looks at the last one.
    page.evaluate("localStorage.clear(); localStorage['drone-env-cycle-pilots'] = 'off'")
    page.evaluate("document.querySelectorAll('dialog[open]').forEach(one => one.close())")
    page.evaluate("document.querySelector('.plan-details')?.removeAttribute('open')")
    show(page, "/?view=learn")
    yield page
    assert tabs.unexpected() == []


@pytest.fixture
def page(loaded: Page, shared: Tabs) -> Generator[Page, None, None]:
    with lent(loaded, shared) as page:
        yield page


@pytest.fixture
def beside(page: Page, shared: Tabs) -> Generator[Callable[[str], Page], None, None]:
    """Opens another tab beside `page`, at a path if there is one."""
    opened: list[Page] = []

    def tab(path: str = "") -> Page:
        opened.append(shared.open(path, beside=page))
        return opened[-1]

    yield tab
    for one in opened:
        one.close()
