"""`examples/post_train.py` and its notebook with TRL, at their smallest sizes: `tools/verify.sh adapters`."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.planning.optimal import solver_of
from tools.docs_notebook import run

pytestmark = pytest.mark.timeout(600)
ROOT = Path(__file__).parents[2]


def test_the_example_trains_by_both_trainers_and_evaluates(tmp_path: Path) -> None:
    command = [sys.executable, "examples/post_train.py", "--quick", "--out", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True, env=os.environ | {"HF_HUB_OFFLINE": "1"}, timeout=500)
    results = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    models = {"sft", "weak", "grpo-score-0", "grpo-regret-0", "grpo-rank-0"}
    assert results["evaluation"].keys() == models | {"optimum", "greedy"}
    assert all((tmp_path / name / "model.safetensors").exists() for name in models)
    assert results["sft"]["answers"] > results["weak"]["answers"] > 0
    for row in results["evaluation"].values():
        assert 0.01 <= row["score"][0] <= results["evaluation"]["optimum"]["score"][0]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", ["score", "regret", "rank"])
def test_an_unusable_answer_is_paid_as_the_worst_of_its_group(kind: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    from post_train import Options, reward_of

    groups = [["UP", "no", "DOWN", "LEFT", ""], ["UP", "UP", "no", "", "UP"], ["no"] * 5]
    flights = [Episode("skyline_easy", seed=seed) for seed in range(3)]
    values = [solver_of(flight).q_values(flight).tolist() for flight in flights for _ in range(5)]
    logged: dict[str, float] = {}
    paid = reward_of(Options(), kind, lambda requests: [Action.WAIT] * len(requests))(
        [[{"content": answer}] for group in groups for answer in group],
        values=values,
        flown=[[flight.seed] for flight in flights for _ in range(5)],
        log_metric=logged.__setitem__,
    )
    assert paid[1] == paid[4] == min(paid[0], *paid[2:4])
    assert len(set(paid[5:10])) == len(set(paid[10:])) == 1
    assert logged == {"unusable": 9 / 15}


def test_the_cells_of_its_notebook_run_without_a_gpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "examples")
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    notebook = json.loads((ROOT / "examples" / "post_train.ipynb").read_text(encoding="utf-8"))
    *_, outputs = run(notebook, tmp_path)
    assert {"optimum", "greedy", "sft", "weak", "grpo-rank-0"} <= set("".join(outputs[0]["text"]).split())
