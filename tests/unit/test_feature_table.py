"""The table of features itself: no promise is without a test, and it fails where one is."""

import re
import subprocess
import sys
from pathlib import Path

from tests.api.serving import ROOT
from tests.feature_table import FEATURES


def test_every_feature_is_spoken_for() -> None:
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")]
    assert {
        feature for source in sources for feature in re.findall(r'mark\.feature\("(\w+)"', source)
    } >= FEATURES.keys()


def features(*arguments: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--features", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def test_the_table_says_what_failed_and_what_has_no_test(tmp_path: Path) -> None:
    two = tmp_path / "test_two.py"
    two.write_text(
        "import pytest\n"
        "@pytest.mark.feature('P4')\ndef test_good(): pass\n"
        "@pytest.mark.feature('E2')\ndef test_bad(): assert 1 == 2\n"
        "def test_of_no_feature(): assert False\n"
    )
    done = features("-c", str(ROOT / "pyproject.toml"), "--rootdir", str(ROOT), "-p", "tests.conftest", str(two))
    assert done.returncode == 1, done.stdout
    cells = [[cell.strip() for cell in line.split("│")] for line in done.stdout.splitlines() if line.startswith("│")]
    results = {feature: result for _, feature, _, result, _ in cells if feature}
    assert list(results) == list(FEATURES)
    assert (results["P4"], results["E2"]) == ("passed", "failed: assert 1 == 2")
    assert results["E1"] == "missing: no test is marked with it"
    assert "1 of 46 features pass" in done.stdout
    assert "1 failed, 1 passed" in done.stdout
