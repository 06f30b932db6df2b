"""The folder that an evaluation goes on from."""

import ctypes
import json
import signal
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from drone_env.cli import main
from drone_env.results import folder as results_folder
from drone_env.results.evaluate import run_episodes
from drone_env.results.result import EpisodesKey, Results


def test_an_evaluation_goes_on_where_it_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, figures = tmp_path / "results", tmp_path / "figures.json"
    command = ["evaluate", "--task", "easy", "--seeds", "0:2500", "--agents", "greedy", "--out", str(folder)]
    assert main([*command, "--json", str(figures)]) == 0
    whole = json.loads(figures.read_text())
    pieces = sorted((folder / "pieces").iterdir())
    assert len(pieces) == 3
    written = [piece.stat().st_mtime_ns for piece in pieces]
    pieces[1].unlink()
    assert main([*command, "--json", str(figures)]) == 0
    assert json.loads(figures.read_text()) == whole
    now = [piece.stat().st_mtime_ns for piece in pieces]
    assert (now[0], now[2]) == (written[0], written[2])
    capsys.readouterr()
    pieces[2].write_bytes(pieces[2].read_bytes()[:-30])
    assert main(command) == 2
    assert "delete it, and its maps are flown again" in capsys.readouterr().err
    other = [*command[:4], "0:2600", *command[5:]]
    assert main(other) == 2
    assert "holds another evaluation: seeds: [0, 2500] is now [0, 2600]" in capsys.readouterr().err
    monkeypatch.setattr(results_folder, "__version__", "99.0")
    assert main(command) == 2
    assert "is now '99.0'" in capsys.readouterr().err


def test_ctrl_c_counts_where_a_callback_of_the_compiler_loses_the_exception(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    press = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))

    def fly(keys: Sequence[EpisodesKey], agents: object) -> Iterator[Results]:
        for key in keys:
            press()
            yield run_episodes(key)

    monkeypatch.setattr("drone_env.commands.evaluate.local_engine", fly)
    folder = tmp_path / "results"
    command = ["evaluate", "--task", "easy", "--seeds", "0:2500", "--agents", "greedy", "--out", str(folder)]
    # What a shell starts in the background ignores SIGINT.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert main(command) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert len(list((folder / "pieces").iterdir())) == 1
    assert f"interrupted; the same command goes on from {folder}" in capsys.readouterr().err
