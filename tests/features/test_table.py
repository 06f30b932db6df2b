"""The table itself: no promise is without a test, and it fails where one is."""

import re
import subprocess
import sys
from pathlib import Path

from tests.api.serving import ROOT
from tests.features.table import PROMISED, feature_of

HERE = Path(__file__).parent


def test_every_feature_has_one_test() -> None:
    sources = [path.read_text(encoding="utf-8") for path in sorted(HERE.glob("test_*.py"))]
    names = re.findall(r"^def (test_\w+)", "".join(sources), re.MULTILINE)
    assert sorted(filter(None, map(feature_of, names))) == sorted(PROMISED)


def test_the_table_says_what_failed_and_what_has_no_test() -> None:
    # One feature, in a place where it cannot pass: the others have no test then.
    command = [sys.executable, "-m", "pytest", "-q", "--features", "tests/features/test_delivery.py", "-k", "test_p4_"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout
    rows = {line.split("│")[1].strip(): line for line in done.stdout.splitlines() if line.startswith("│")}
    assert list(rows) == PROMISED
    assert "passed" in rows["P4"]
    assert "missing: no test has its id" in rows["E1"]
    assert "1 of 46 features pass" in done.stdout
