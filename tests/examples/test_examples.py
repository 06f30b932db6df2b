"""Every file of examples/ is sound, and runs and shows its score beside the optimum. A new one is found by itself."""

import ast
import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.docs.shell import check_python
from tests.tools import LEFT_OUT, missing_tool

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
SHORT = {
    "cleanrl_dqn": ["--total-timesteps", "3000", "--maps", "5"],
    "llm_evaluation": ["--maps", "2"],
    "new_task_and_reward": ["--episodes", "20", "--maps", "2"],
    "openenv_client": ["--task", "easy", "--maps", "2"],
    "pytorch_loop": ["--total-timesteps", "2048", "--maps", "5"],
    "sb3_ppo": ["--total-timesteps", "2048", "--maps", "5"],
}
"""Flags that keep them short; an example that is not named here runs as it is."""
PAIR = re.compile(r"score (0\.\d+)[^\n]*optimum[^\n]*? (0\.\d+)")
every_example = pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)


def flags_of(tree: ast.Module) -> set[str]:
    """What its command line takes: arguments of argparse, fields of the dataclass that tyro reads."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "add_argument":
            found.update(argument.value for argument in node.args if isinstance(argument, ast.Constant))
        elif isinstance(node, ast.ClassDef) and node.name == "Args":
            fields = [line.target.id for line in node.body if isinstance(line, ast.AnnAssign)]
            found.update(f"--{field.replace('_', '-')}" for field in fields)
    return found


def problems_of(example: Path) -> list[str]:
    """What is wrong with it, as far as that can be known without running it."""
    text = example.read_text(encoding="utf-8")
    check_python(text, example.name)
    tree = ast.parse(text)
    imports = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    imports += [str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    absent = [name for name in imports if find_spec(name.partition(".")[0]) is None]
    for name in absent:
        if name.partition(".")[0] in LEFT_OUT:
            missing_tool(name)
    problems = [f"it imports {name}" for name in absent]
    commands = re.findall(rf"python examples/{example.name}(.*)", ast.get_docstring(tree) or "")
    told = {flag for command in commands for flag in re.findall(r"--[a-z-]+", command.partition("#")[0])}
    named = told | {word for word in SHORT.get(example.stem, []) if word.startswith("--")}
    problems += [f"it knows no {flag}" for flag in sorted(named - flags_of(tree))]
    if not commands:
        problems.append("its first lines do not say how it is run")
    if f"examples/{example.name}" not in (ROOT / "docs" / "examples.md").read_text(encoding="utf-8"):
        problems.append("it is not on the page of the examples")
    return problems


@every_example
def test_an_example_is_sound(example: Path) -> None:
    assert problems_of(example) == []


def test_what_is_wrong_with_an_example_is_noticed(tmp_path: Path) -> None:
    example = tmp_path / "new.py"
    example.write_text('"""New.\n\n    python examples/new.py --fast --seed 7  # --not-this\n"""\nimport nowhere\n'
                       'parser.add_argument("--seed")\n')  # fmt: skip
    assert problems_of(example) == ["it imports nowhere", "it knows no --fast", "it is not on the page of the examples"]
    example.write_text("from drone_env import Nothing\n")
    with pytest.raises(AssertionError, match="has no Nothing"):
        problems_of(example)


@pytest.mark.long
@every_example
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
