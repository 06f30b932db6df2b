"""`examples/post_train.py` and its notebook with TRL, at their smallest sizes: `tools/verify.sh adapters`."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tools.docs_notebook import run

pytestmark = pytest.mark.timeout(600)
ROOT = Path(__file__).parents[2]


def test_the_example_trains_by_both_trainers_and_evaluates(tmp_path: Path) -> None:
    command = [sys.executable, "examples/post_train.py", "--quick", "--out", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, env=os.environ | {"HF_HUB_OFFLINE": "1"}, timeout=500)
    results = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    models = {"sft", "weak", "grpo-score-0", "grpo-regret-0", "grpo-rank-0"}
    assert results["evaluation"].keys() == models | {"optimum", "greedy", "nearest"}
    assert all((tmp_path / name / "model.safetensors").exists() for name in models)
    assert results["sft"]["answers"] > results["weak"]["answers"] > 0
    for row in results["evaluation"].values():
        assert 0.01 <= row["score"][0] <= results["evaluation"]["optimum"]["score"][0]


def test_the_cells_of_its_notebook_run_without_a_gpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    notebook = json.loads((ROOT / "examples" / "post_train.ipynb").read_text(encoding="utf-8"))
    *_, outputs = run(notebook, tmp_path)
    assert {"optimum", "greedy", "sft", "weak", "grpo-rank-0"} <= set("".join(outputs[0]["text"]).split())
