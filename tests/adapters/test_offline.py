"""`examples/offline.py` at its smallest size, from the command that makes its data."""

import re
import sys
from pathlib import Path

import pytest

from drone_env.cli import main
from tests.docs.pages import ROOT
from tests.tools import ran

pytest.importorskip("minari")


@pytest.mark.timeout(900)
def test_both_algorithms_learn_from_a_dataset_and_report_normalised_scores(tmp_path: Path) -> None:
    data = ["--task", "easy", "--maps", "30", "--agents", "random", "greedy"]
    assert main(["dataset", "--minari", "--out", str(tmp_path / "flights"), *data]) == 0
    small = ["--dataset", "drone_delivery_easy-v1", "--seeds", "0", "--updates", "100", "--maps", "20"]
    variables = {"MINARI_DATASETS_PATH": str(tmp_path / "flights" / "minari")}
    done = ran(sys.executable, ROOT / "examples" / "offline.py", *small, **variables)
    assert done.returncode == 0, done.stderr
    lines = re.findall(r"(.+), seed 0: score (0\.\d+), optimum (0\.\d+), normalised (-?\d\.\d+)", done.stdout)
    assert [name for name, *_ in lines] == ["cloning", "implicit Q-learning"]
    for _, score, optimum, normalised in lines:
        assert 0.3 < float(score) <= float(optimum)  # random: 0.2
        assert 0 < float(normalised) < 1.05
