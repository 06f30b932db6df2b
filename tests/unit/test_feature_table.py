"""Every promised feature has a test, which `@pytest.mark.feature` marks with its id."""

import re

from tests.api.serving import ROOT

COUNTS = {"E": 10, "L": 7, "H": 14, "I": 3, "D": 5, "P": 7}
"""Environment, learning, HTTP server, inference, dashboard, delivery: how many features each promises."""


def test_every_feature_has_a_test() -> None:
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")]
    marks = [mark for source in sources for mark in re.findall(r"mark\.feature\((.+?)\)", source)]
    marked = set(re.findall(r"\b[A-Z]\d+\b", " ".join(marks)))
    assert marked == {f"{part}{number}" for part, count in COUNTS.items() for number in range(1, count + 1)}
