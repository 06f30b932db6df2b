"""The golden hashes come out everywhere: in any process, compiled, and on the oldest and newest Python."""

import json
import os

import pytest

from drone_env.core.batch import Batch
from tests.parity.golden import (
    GOLDEN_FILE,
    N_FIRST,
    N_SEEDS,
    Hashes,
    Reference,
    golden_hashes,
    golden_seeds,
)
from tests.tools import find_python, find_tool, missing_tool, ran

GOLDEN: Hashes = json.loads(GOLDEN_FILE.read_text(encoding="utf-8"))
FIRST = {name: {**hashes, **hashes["first"]} for name, hashes in GOLDEN.items()}
"""The hashes over the first seeds alone."""
THOROUGH = int(os.environ.get("DRONE_ENV_EXAMPLES", "0")) >= 10_000
ELSEWHERE, EXPECTED = (N_SEEDS, GOLDEN) if THOROUGH else (N_FIRST, FIRST)


@pytest.mark.long
def test_in_plain_python() -> None:
    assert golden_hashes(Reference, golden_seeds(ELSEWHERE), at_once=1) == EXPECTED


def test_compiled() -> None:
    assert golden_hashes(Batch, golden_seeds(N_SEEDS), at_once=400_000) == GOLDEN


@pytest.mark.campaign
@pytest.mark.parametrize("version", ["3.10", "3.13"])
def test_on_another_python_without_numba(version: str) -> None:
    alone = ["run", "--isolated", "--no-project", "--with", "numpy", "--with", "gymnasium", "--python"]
    golden = ["python", "-W", "error", "tests/parity/golden.py", "--seeds", ELSEWHERE]
    done = ran(find_tool("uv"), *alone, find_python(version), *golden)
    if "Failed to fetch" in done.stderr:
        missing_tool("an index of packages")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == EXPECTED
