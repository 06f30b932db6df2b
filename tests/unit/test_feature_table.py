"""Every promised feature has a test, which `@pytest.mark.feature` marks with its id."""

import re

from tests.api.serving import ROOT

COUNTS = {"E": 10, "L": 7, "H": 14, "I": 3, "D": 5, "P": 7}
"""Environment, learning, HTTP server, inference, dashboard, delivery: how many features each promises."""


def test_every_feature_has_a_test() -> None:
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")]
    marked = {feature for source in sources for feature in re.findall(r'mark\.feature\("(\w+)"', source)}
    assert marked == {f"{part}{number}" for part, count in COUNTS.items() for number in range(1, count + 1)}
