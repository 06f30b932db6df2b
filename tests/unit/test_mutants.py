"""tools/mutants.py, on a project of two files, and its table."""

import json
import subprocess
from collections import Counter
from pathlib import Path

import pytest

from tools.mutants import main, read_table

TABLE = """
[[mutant]]
id = "caught"
file = "half.py"
why = "a third is no half"
old = "x / 2"
new = "x / 3"
tests = ["test_half.py::test_of_four"]

[[mutant]]
id = "survivor"
file = "half.py"
why = "odd numbers lose their half"
old = "x / 2"
new = "x // 2"
tests = ["test_half.py"]

[[mutant]]
id = "breaks-imports"
file = "half.py"
why = "this says nothing of the tests"
old = "def"
new = "import no_such_module\\n\\n\\ndef"
tests = ["test_half.py"]

[[mutant]]
id = "stale"
file = "half.py"
why = "the code has changed"
old = "x * 0.5"
new = "x"
tests = ["test_half.py"]
"""


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    # The tests inside of these tests need no other plugins, and start twice as fast.
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    monkeypatch.setenv("PYTEST_PLUGINS", "xdist.plugin,pytest_timeout")
    (tmp_path / "half.py").write_text("def half(x):\n    return x / 2\n")
    (tmp_path / "test_half.py").write_text("from half import half\n\n\ndef test_of_four():\n    assert half(4) == 2\n")
    (tmp_path / "test_other.py").write_text("def test_that_no_row_names():\n    assert False\n")
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "mutants.toml").write_text(TABLE)
    subprocess.run(["git", "init", "--quiet"], cwd=tmp_path, check=True)
    subprocess.run(["git", "add", "."], cwd=tmp_path, check=True)
    return tmp_path


def test_each_fault_is_put_in_alone_and_told_by_what_came_of_it(
    project: Path, tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(path for path in project.rglob("*") if ".git" not in path.parts)
    found = tmp_path_factory.mktemp("found") / "found.json"

    # More at once than there are tests.
    assert main(["--jobs", "3", "--json", str(found)], root=project) == 1

    verdicts = {row["id"]: (row["verdict"], row["by"]) for row in json.loads(found.read_text())}
    assert verdicts == {
        "caught": ("caught", "test_half.py::test_of_four"),
        "survivor": ("survived", "odd numbers lose their half"),
        "breaks-imports": ("error", "exit status 2 of pytest: no test failed"),
        "stale": ("error", "stale: what is to be replaced stands 0 times in the file"),
    }
    *lines, summary = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("caught"), "what nobody caught is told last"
    assert summary == "1 of 4 faults caught"
    assert sorted(path for path in project.rglob("*") if ".git" not in path.parts) == before


def test_the_table_fits_the_files_and_covers_every_part() -> None:
    table = read_table()
    assert [(mutant.id, mutant.by) for mutant in table if mutant.verdict] == []
    parts = Counter(mutant.file.split("/")[1] for mutant in table)
    assert {"core", "planning", "server", "results", "llm", "rl"} <= parts.keys()
    assert len(table) >= 60
    assert sum("/static/js/" in mutant.file for mutant in table) >= 10
