"""The folder that an evaluation goes on from."""

from pathlib import Path

import pytest

from drone_env.agents import SHIPPED_AGENTS
from drone_env.cli import main
from drone_env.core.tasks import TASKS
from drone_env.results import folder as results_folder
from drone_env.results.evaluate import episodes_key
from drone_env.results.folder import SHIPPED, EvaluationConfig


def test_an_evaluation_goes_on_where_it_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "results"
    command = ["evaluate", "--task", "easy", "--seeds", "0:2500", "--agents", "greedy", "--out", str(folder)]
    assert main(command) == 0
    whole = capsys.readouterr().out
    pieces = sorted((folder / "pieces").iterdir())
    assert len(pieces) == 3
    written = [piece.stat().st_mtime_ns for piece in pieces]
    pieces[1].unlink()
    assert main(command) == 0
    assert capsys.readouterr().out == whole
    now = [piece.stat().st_mtime_ns for piece in pieces]
    assert (now[0], now[2]) == (written[0], written[2])
    pieces[2].write_bytes(pieces[2].read_bytes()[:-30])
    assert main(command) == 2
    assert "delete it, and its maps are flown again" in capsys.readouterr().err
    other = [*command[:4], "0:2600", *command[5:]]
    assert main(other) == 2
    assert (
        "holds another evaluation: only one of the two has EpisodesKey(task='easy_delivery'" in capsys.readouterr().err
    )
    monkeypatch.setattr(results_folder, "__version__", "99.0")
    assert main(command) == 2
    assert "holds an evaluation by version 0.5.0" in capsys.readouterr().err


def test_the_shipped_results_are_of_the_present_agents_and_tasks() -> None:
    keys = EvaluationConfig.load(SHIPPED).keys
    assert ({key.task for key in keys}, {key.agent for key in keys}) == (set(TASKS), set(SHIPPED_AGENTS))
    stale = [key for key in keys if key != episodes_key(key.task, key.agent, range(*key.seeds), key.split)]
    assert stale == [], "run tools/docs_generate.py results"
