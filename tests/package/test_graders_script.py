"""`check_graders.py`, on the manifest as it is; tests/unit/test_graders.py has manifests that are wrong."""

import subprocess
import sys

import pytest

from tests.package.installed import ROOT


@pytest.mark.feature("P4")
def test_the_graders_of_the_manifest_are_found_and_right() -> None:
    done = subprocess.run([sys.executable, "check_graders.py"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-2:] == ["Summary: 3 valid graders found.", "LOCAL CHECK PASSED."]
