"""Every file of examples/ runs, and shows its score beside the optimum. A new one is found by itself."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SHORT = {
    "cleanrl_dqn": ["--total-timesteps", "4000", "--maps", "20"],
    "llm_evaluation": ["--maps", "4"],
    "new_task_and_reward": ["--episodes", "40", "--maps", "5"],
    "openenv_client": ["--task", "easy", "--maps", "2"],
    "pytorch_loop": ["--total-timesteps", "4096", "--maps", "20"],
    "sb3_ppo": ["--total-timesteps", "2048", "--maps", "20"],
}
"""Flags that keep them short; an example that is not named here runs as it is."""
PAIR = re.compile(r"score (0\.\d+)[^\n]*optimum[^\n]*? (0\.\d+)")


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs_and_shows_its_score_beside_the_optimum(example: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    command = [sys.executable, str(example), *SHORT.get(example.stem, [])]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    if example.stem == "new_task_and_reward":  # the table of `drone-env evaluate`
        assert re.search(r"optimal +0\.9\d+", done.stdout)
        assert "Verdict: aligned" in done.stdout
        return
    pairs = PAIR.findall(done.stdout)
    assert pairs, done.stdout
    assert all(0 < float(score) <= float(optimum) < 1 for score, optimum in pairs)


def test_each_example_is_on_the_page() -> None:
    page = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
    assert [path.name for path in EXAMPLES if f"examples/{path.name}" not in page] == []
