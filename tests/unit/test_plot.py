"""`drone-env plot`: which runs it takes, how it groups them, and its statistics."""

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from drone_env.cli import main
from drone_env.results.statistics import iqm_interval
from drone_env.results.training import group_curves, read_runs

RUNS = np.array([[0.91, 0.5], [0.95, 0.62], [0.2, 0.71], [0.97, 0.55], [0.93, 0.4]])


def write_run(folder: Path, ratios: list[float], *, optimum: float = 1.0, head: str = "steps", **settings: Any) -> None:
    """Write a run whose history has a line without a validation, then one for each ratio, ten steps apart."""
    folder.mkdir(parents=True)
    text = {"algorithm": "ppo", "task": "easy", "seed": 0, **settings}
    (folder / "config.toml").write_text("".join(f"{name} = {value!r}\n" for name, value in text.items()))
    lines = [f"{10 * n},{n}.5,{ratio},{optimum}" for n, ratio in enumerate([np.nan, *ratios], 1)]
    (folder / "history.csv").write_text("\n".join([f"{head},cpu_seconds,validation,validation_optimum", *lines]) + "\n")


@pytest.mark.parametrize(("tasks", "expected"), [([0], (0.93, 0.4367, 0.9633)), ([0, 1], (0.7033, 0.48, 0.8083))])
def test_means_and_intervals_are_those_of_rliable(tasks: list[int], expected: tuple[float, ...]) -> None:
    assert [end.item() for end in iqm_interval([RUNS[:, [task]] for task in tasks])] == pytest.approx(
        expected, abs=2e-3
    )


def test_the_command_leaves_figures_and_tables_and_says_what_it_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for seed, last in enumerate(RUNS[:, 0].tolist()):
        write_run(tmp_path / f"runs/easy {seed}/ppo_easy", [0.1, last], seed=seed, steps=30)
        write_run(tmp_path / f"runs/hard {seed}", [0.2, RUNS[seed, 1].item()], seed=seed, task="hard_delivery")
    write_run(tmp_path / "runs/half", [0.1, 0.2], seed=7, steps=300)
    write_run(tmp_path / "runs/begun", [], seed=8)
    (tmp_path / "runs/half/stray.txt").touch()
    (tmp_path / "runs/half/empty").mkdir()
    (tmp_path / "runs/begun/2").mkdir()
    (tmp_path / "runs/begun/2/config.toml").write_text("x = 1")
    assert main(["plot", "runs", "runs/easy 0", "--x", "steps"]) == 0
    printed = capsys.readouterr()
    assert printed.err.splitlines()[:-1] == [
        "left out: runs/begun: no validation yet",
        "left out: runs/begun/2: 'algorithm' is missing",
        "left out: runs/half: unfinished: 30 of 300 steps",
    ]
    rows = [line.strip("| ").split(" | ") for line in Path("plots/scores.md").read_text().splitlines()[2:]]
    assert [row[:4] for row in rows] == [
        ["easy", "ppo", "5", "0.9300"],
        ["hard", "ppo", "5", "0.5567"],
        ["all 2", "ppo", "5", "0.7033"],
    ]
    assert [re.split(" {2,}", line.strip()) for line in printed.out.splitlines() if "ppo" in line] == rows
    assert "95 \\% interval \\\\\n\\midrule\neasy & ppo & 5 & 0.9300 & [" in Path("plots/scores.tex").read_text()
    files = {file: file.read_bytes() for file in sorted(Path("plots").glob("*.[ps][dv]*"))}
    assert len(files) == 4
    assert all(content.startswith(b"%PDF-") for file, content in files.items() if file.suffix == ".pdf")
    assert all(
        ElementTree.fromstring(content).tag[-3:] == "svg" for file, content in files.items() if "v" in file.suffix
    )
    assert main(["plot", "runs", "--x", "steps"]) == 0  # the same runs give the same figures
    assert {file: file.read_bytes() for file in files} == files
    capsys.readouterr()
    assert main(["plot", "runs", "--x", "minutes"]) == 2
    assert "unknown column of ppo on easy 'minutes'; allowed: cpu_seconds, steps, validat" in capsys.readouterr().err
    assert main(["plot", "runs/half"]) == 2
    assert "there is no finished training run in the folders" in capsys.readouterr().err


def test_groups_share_all_settings_but_the_seed(tmp_path: Path) -> None:
    for n, rate in enumerate((0.1, 0.1, 0.2)):
        write_run(tmp_path / f"a{n}", [0.5, 0.7, 0.9], seed=n, learning_rate=rate, num_threads=n)
    write_run(tmp_path / "tour", [0.8], task="all", head="validation_hard", algorithm="tournet")
    write_run(tmp_path / "town", [0.8], task="maps/town.toml", optimum=float("nan"))
    curves, left_out = read_runs([tmp_path])
    groups = {(group.label, group.task): group for group in group_curves(curves)}
    assert left_out == [f"{tmp_path / 'town'}: the optimum is not known"]
    assert {key: len(group.curves) for key, group in groups.items()} == {
        ("ppo, learning_rate=0.1", "easy"): 2,
        ("ppo, learning_rate=0.2", "easy"): 1,
        ("tournet", "hard"): 1,
    }
    values, mean, low, high = groups["ppo, learning_rate=0.2", "easy"].over("cpu_seconds")
    assert (values.tolist(), mean.tolist()) == ([2.5, 3.5, 4.5], pytest.approx([0.5, 0.7, 0.9]))
    assert np.isnan([low, high]).all()
