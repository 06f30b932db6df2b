"""The table of features: what was promised, by id, and whether its test passes. `make features` prints it.

A feature's text is the first line of its test's docstring; its id is the start of the test's name.
"""

import re

import pytest
from rich.console import Console
from rich.markup import escape
from rich.table import Table

ROWS = {"E": 10, "L": 7, "H": 14, "I": 3, "D": 5, "P": 7}
"""How many features each group has: environment, learning, HTTP server, inference, dashboard, delivery."""
PROMISED = [f"{group}{number}" for group, count in ROWS.items() for number in range(1, count + 1)]
NAME = re.compile(r"test_([a-z]\d+)_")
STYLES = {"passed": "green", "failed": "bold red", "skipped": "yellow", "missing": "bold red"}
TEXT = "feature"


def feature_of(test: str) -> str | None:
    """The id in the name of a test, such as "E1"; None where it has none."""
    found = NAME.match(test)
    return found[1].upper() if found else None


class FeatureTable:
    """Keeps what became of each feature, prints the table, and fails the run where one has no test.

    A feature with several tests has passed when all of them have.
    """

    def __init__(self) -> None:
        self.texts: dict[str, str] = {}
        self.outcomes: dict[str, str] = {}
        self.reasons: dict[str, str] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note one phase of one test: its own, or a set-up or tear-down that did not pass."""
        text = dict(report.user_properties).get(TEXT)
        if text is None or (report.when != "call" and report.passed):
            return
        feature = feature_of(report.location[2])
        assert feature is not None
        self.texts[feature] = str(text)
        if self.outcomes.get(feature, "passed") == "passed" or report.failed:
            self.outcomes[feature] = report.outcome
            self.reasons[feature] = "" if report.passed else reason_of(report)

    def missing(self) -> list[str]:
        """The promised features that no test has spoken for."""
        return [feature for feature in PROMISED if feature not in self.outcomes]

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """A feature without a test fails the run."""
        if self.missing() and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self) -> None:
        """Print it."""
        table = Table("id", "feature", "result", title="Features", title_justify="left")
        for feature in PROMISED:
            outcome = self.outcomes.get(feature, "missing")
            reason = self.reasons.get(feature, "") if feature in self.outcomes else "no test has its id"
            result = f"[{STYLES[outcome]}]{outcome}[/]" + (f": {reason}" if reason else "")
            table.add_row(feature, escape(self.texts.get(feature, "-")), result)
        passed = list(self.outcomes.values()).count("passed")
        console = Console(width=None if Console().is_terminal else 150)
        console.print()
        console.print(table)
        console.print(f"{passed} of {len(PROMISED)} features pass")


def reason_of(report: pytest.TestReport) -> str:
    """Why a test failed or was skipped, in a line."""
    if isinstance(report.longrepr, tuple):
        return escape(report.longrepr[2].removeprefix("Skipped: "))
    crash = getattr(report.longrepr, "reprcrash", None)
    return escape(str(report.longrepr if crash is None else crash.message).splitlines()[0])
