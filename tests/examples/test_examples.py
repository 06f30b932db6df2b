"""Every file of examples/ is sound, and runs and shows its score beside the optimum. A new one is found by itself."""

import ast
import re
import sys
from pathlib import Path

import pytest

from tests.api.serving import Server
from tests.docs.shell import check_python
from tests.tools import ROOT, ran

EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SHORT = {
    "cleanrl_dqn": ["--total-timesteps", "3000", "--maps", "5"],
    "llm_evaluation": ["--maps", "2"],
    "new_task_and_reward": ["--episodes", "20", "--maps", "2"],
    "openenv_client": ["--task", "easy", "--maps", "2", "--url", "{url}"],
    "sweep": ["--episodes", "16", "--seeds", "1", "--maps", "5", "--out", "sweep"],
    "sb3_ppo": ["--total-timesteps", "2048", "--maps", "5"],
}
"""Flags that keep them short; an example that is not named here runs as it is."""
ELSEWHERE = ("offline", "post_train")
"""tests/adapters runs them: they need data, or TRL."""
PAIR = re.compile(r"score (0\.\d+)[^\n]*optimum[^\n]*? (0\.\d+)")


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_sound(example: Path) -> None:
    text = example.read_text(encoding="utf-8")
    check_python(text, example.name)
    assert f"python examples/{example.name}" in (ast.get_docstring(ast.parse(text)) or "")
    assert f"examples/{example.name}" in (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")


@pytest.mark.long
@pytest.mark.parametrize(
    "example", [path for path in EXAMPLES if path.stem not in ELSEWHERE], ids=lambda path: path.stem
)
def test_an_example_runs_and_shows_its_score_beside_the_optimum(example: Path, tmp_path: Path, server: Server) -> None:
    options = [option.format(url=server.url) for option in SHORT.get(example.stem, [])]
    done = ran(sys.executable, example, *options, cwd=tmp_path, TMPDIR=str(tmp_path))
    assert done.returncode == 0, done.stderr
    if example.stem == "new_task_and_reward":  # the table of `drone-env evaluate`
        assert re.search(r"optimal +0\.9\d+", done.stdout)
        assert "Verdict: aligned" in done.stdout
        return
    pairs = PAIR.findall(done.stdout)
    assert pairs, done.stdout
    assert all(0 < float(score) <= float(optimum) < 1 for score, optimum in pairs)
