"""The golden hashes come out everywhere: in any process, compiled, and on the oldest and newest Python."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

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
from tests.tools import find_python, missing_tool, ran

GOLDEN: Hashes = json.loads(GOLDEN_FILE.read_text(encoding="utf-8"))
FIRST = {name: {**hashes, **hashes["first"]} for name, hashes in GOLDEN.items()}
"""The hashes over the first seeds alone."""
THOROUGH = int(os.environ.get("DRONE_ENV_EXAMPLES", "0")) >= 10_000
ELSEWHERE, EXPECTED = (N_SEEDS, GOLDEN) if THOROUGH else (N_FIRST, FIRST)


def hashes_from_another_process(python: str) -> dict[str, Any]:
    """What `golden.py` prints under this interpreter."""
    done = ran(python, "-W", "error", "tests/parity/golden.py", "--seeds", ELSEWHERE)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def python_without_numba(version: str, folder: Path) -> str:
    """An interpreter of this version with NumPy and Gymnasium alone, made once and kept in `folder`.

    The folder lies in the environment of the tests: in the tree, a validator would take it for a part of the project.
    """
    python, ready = str(folder / "bin/python"), folder / "has-numpy-and-gymnasium"
    if not ready.exists():
        subprocess.run([find_python(version), "-m", "venv", "--clear", str(folder)], capture_output=True, check=True)
        install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "numpy", "gymnasium"]
        if subprocess.run(install, capture_output=True, check=False).returncode != 0:
            missing_tool(f"NumPy and Gymnasium for Python {version}")
        ready.touch()
    return python


def test_in_plain_python() -> None:
    assert golden_hashes(Reference, golden_seeds(N_FIRST), at_once=1) == FIRST


@pytest.mark.long
def test_all_of_them_in_plain_python() -> None:
    assert golden_hashes(Reference, golden_seeds(N_SEEDS), at_once=1) == GOLDEN


def test_compiled() -> None:
    assert golden_hashes(Batch, golden_seeds(N_SEEDS), at_once=400_000) == GOLDEN


@pytest.mark.long
@pytest.mark.parametrize("version", ["3.10", "3.13"])
def test_on_another_python_without_numba(version: str) -> None:
    python = python_without_numba(version, Path(sys.prefix) / f"golden-python-{version}")
    assert hashes_from_another_process(python) == EXPECTED
