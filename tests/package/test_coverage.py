"""The tests tell how much of the code they cover."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.package.installed import ROOT


@pytest.mark.feature("P6")
def test_pytest_tells_how_much_of_the_code_is_covered(tmp_path: Path) -> None:
    report = tmp_path / "coverage.json"
    # One that takes no time: all of tests/test_env.py and tests/test_api.py is run beside this one.
    command = ["-q", "tests/test_env.py", "-k", "battery", "-p", "no:cacheprovider", "-p", "no:xdist",
               "--cov=drone_env/core", f"--cov-report=json:{report}"]  # fmt: skip
    environment = {**os.environ, "COVERAGE_FILE": str(tmp_path / "coverage")}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *command],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout
    covered = json.loads(report.read_text(encoding="utf-8"))["files"]["drone_env/core/episode.py"]
    assert 40 < covered["summary"]["percent_covered"] < 100
