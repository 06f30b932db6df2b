"""Fixtures of all tests: an empty working directory, restored registries, and skips for missing tools."""

# First, so that no variable of the user's is read.
from tests.environment import DISPLAY

# isort: split
import gc
import os
from collections.abc import Generator
from contextlib import ExitStack
from pathlib import Path
from typing import TypeVar
from unittest.mock import patch

import gymnasium
import pytest

from drone_env.agents import AGENTS
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.core.tasks import TASKS
from drone_env.envs.registry import FILES, PLUGINS
from drone_env.errors import install_command
from drone_env.flights import store
from drone_env.graders import GRADERS
from tests.api.serving import Server, serving
from tests.tools import PATIENCE, missing_in, missing_package

Report = TypeVar("Report", pytest.CollectReport, pytest.TestReport)
# The tests run side by side: threads that wait for each other must not spin on cores that others need.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
# Imported and collected objects stay. The search for garbage among them takes a fifth of the time.
gc.disable()


@pytest.fixture(scope="session", autouse=True)
def neutral_place(tmp_path_factory: pytest.TempPathFactory) -> Generator[None, None, None]:
    """Run the tests, and the programs that they start, in an empty folder: no `.env`, no `data` of the user's."""
    for name in DISPLAY:
        os.environ.pop(name, None)
    # Stable-Baselines3 makes a folder in /tmp for each log otherwise.
    os.environ["SB3_LOGDIR"] = str(tmp_path_factory.getbasetemp() / "sb3")
    before = Path.cwd()
    os.chdir(tmp_path_factory.mktemp("empty"))
    yield
    os.chdir(before)


@pytest.fixture(autouse=True)
def registered(monkeypatch: pytest.MonkeyPatch) -> Generator[None, None, None]:
    """Restore the registries after each test, in this process and for started ones."""
    # Both calls, so that it is absent during the test and after it.
    monkeypatch.setenv(PLUGINS, "")
    monkeypatch.delenv(PLUGINS)
    with ExitStack() as restored:
        for names in (TASKS, GRADERS, REWARD_PROFILES, FILES, AGENTS, gymnasium.registry):
            restored.enter_context(patch.dict(names))
        yield


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Generator[Server, None, None]:
    """A server process that all tests share."""
    with serving(tmp_path_factory.mktemp("server") / "data", CAPACITY="2000") as running:
        yield running


@pytest.fixture(scope="session", autouse=True)
def patience() -> None:
    """Let servers in this process wait for optima on a busy machine."""
    store.PATIENCE = PATIENCE


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--one-case", action="store_true", help="of a test with several cases, run the first")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("one_case"):
        first: dict[str, pytest.Item] = {}
        for item in items:
            first.setdefault(item.nodeid.partition("[")[0], item)
        items[:] = first.values()
    side_by_side(items, int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))


def side_by_side(items: list[pytest.Item], workers: int) -> None:
    """Put the slowest tests, those of the browser, where two workers begin: nobody waits for the last of them.

    Workers begin with equal shares, and then take from the ends of other shares: so only these two start a browser.
    """
    slow = [item for item in items if item.path.parent.name == "browser"]
    others = [item for item in items if item.path.parent.name != "browser"]
    first = len(slow) // 2 if workers > 2 else len(slow)
    rest = len(items) // workers - first
    if workers > 1:
        items[:] = slow[:first] + others[:rest] + slow[first:] + others[rest:]


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(
    collector: pytest.Collector,
) -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    return skipped_for_want((yield), str(collector.path))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    return skipped_for_want((yield), str(item.path))


def skipped_for_want(report: Report, path: str) -> Report:
    """Turn a failure into a skip if a package is missing that `uv sync` leaves out."""
    package = missing_package(str(report.longrepr)) if report.failed else None
    if package:
        report.outcome = "skipped"
        report.longrepr = (path, 0, f"Skipped: missing tool: {package}")
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    skipped = terminalreporter.stats.get("skipped", [])
    missing = missing_in(str(report.longrepr) for report in skipped)
    if missing:
        hint = f"to install the Python packages, run: {install_command('dev')}"
        terminalreporter.write_line(f"{len(skipped)} tests or files skipped; missing: {', '.join(missing)}; {hint}")
