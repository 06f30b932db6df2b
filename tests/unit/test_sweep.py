"""Sweeps: what is tried, and that nothing is lost or done twice, whatever is killed."""

import multiprocessing
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("optuna")
pytest.importorskip("torch")

import optuna
from optuna.trial import TrialState

from drone_env.cli import main
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.results.statistics import SHARES, crossed, interval
from drone_env.rl import sweep
from drone_env.rl.run import load_checkpoint

SMALL = (
    "num_envs=8", "batch_size=16", "replay_size=400", "learning_starts=50", "steps_per_update=32",
    "validation_every=10", "validation_maps=5", "log_every=5",
)  # fmt: skip


def config_of(*sets: str, early_stopping: bool = True, **values: Any) -> sweep.SweepConfig:
    space = dict(map(sweep.values_of, [*SMALL, *sets]))
    values = {"preset": "fast", "seeds": 2, "test_maps": 20, **values}
    return sweep.SweepConfig("easy", space=space, early_stopping=early_stopping, **values)


def swept(out: Path, config: sweep.SweepConfig) -> list[Any]:
    """The finished trials: setting, state, scores and results of each."""
    sweep.run(out, config, 1)
    sweep.write_report(out, config)
    trials = sweep.open_study(out, config).get_trials()
    return [(trial.params, trial.state.name, trial.intermediate_values, trial.user_attrs) for trial in trials]


def parameters(folder: Path) -> dict[str, list[float]]:
    return {name: tensor.tolist() for name, tensor in load_checkpoint(folder / "easy.pth")["best"].items()}


# What is tried


def test_values_have_the_types_of_training() -> None:
    assert sweep.values_of("lr=1e-3,3e-4") == ("learning_rate", [1e-3, 3e-4])
    assert sweep.values_of("steps-per-update=8") == ("steps_per_update", [8.0])
    assert sweep.values_of("double=true,false")[1] == [True, False]
    config = config_of("lr=1e-3,3e-4", "double=true,false")
    varied = [(setting["learning_rate"], setting["double"]) for setting in config.settings]
    assert varied == [(lr, double) for lr in (1e-3, 3e-4) for double in (True, False)]


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["speed=1"], "unknown setting 'speed'; allowed: .*batch_size.* lr,"),
        (["target_update=l1"], "target_update=l1.*'soft' or 'episodes'"),
        (["gamma=nan"], "finite"),
        (["gamma"], "NAME=VALUE"),
        (["gamma=0.9,1.5"], "gamma should be less than or equal to 1"),
        (["seed=1"], "unknown setting 'seed'"),
        (["lr=uniform(2,1)"], "valid number"),
        (["episodes=100,200"], "different episodes.*--no-early-stopping"),
    ],
)  # fmt: skip
def test_what_cannot_be_set_is_refused(sets: list[str], message: str) -> None:
    with pytest.raises((UnknownNameError, InvalidValueError), match=message):
        config_of(*sets)


def test_a_dry_run_lists_the_settings_and_trains_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "sweep"
    assert main(["sweep", "--set", "gamma=0.9,0.8", "--out", str(out), "--dry-run"]) == 0
    assert capsys.readouterr().out == "2 settings with 3 seeds each\ngamma=0.9\ngamma=0.8\n"
    assert not out.exists()


def test_a_folder_contains_one_sweep(tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    sweep.open_study(out, config_of("gamma=0.9"))
    sweep.open_study(out, config_of("gamma=0.9"))
    with pytest.raises(InvalidValueError, match=r"another configuration: space: .*0.9.* is now .*0.8.*; seeds: 2 is"):
        sweep.open_study(out, config_of("gamma=0.8", seeds=1))
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(InvalidValueError, match="contains other files"):
        sweep.open_study(tmp_path, config_of())


# What is trained


def test_the_interval_covers_seeds_and_maps() -> None:
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(50):
        scores = 0.5 + 0.1 * rng.standard_normal((12, 1)) + 0.1 * rng.standard_normal(40)
        found = crossed(scores, SHARES)
        assert found is not None
        assert found.low < found.mean < found.high
        covered += found.low <= 0.5 <= found.high
    assert 42 <= covered <= 50
    # One seed is as certain as its maps are.
    assert crossed(scores[:1], SHARES) == pytest.approx(interval(scores[0], SHARES))


def test_settings_that_fall_behind_are_stopped_with_all_their_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    halving = optuna.pruners.SuccessiveHalvingPruner(min_resource=10, reduction_factor=2)
    # Hyperband's brackets depend on the numbers of the trials.
    monkeypatch.setattr(optuna.pruners.HyperbandPruner, "prune", lambda _, *trial: halving.prune(*trial))
    monkeypatch.setattr(sweep, "_best_until", lambda run, lines, episodes: 1e3 * run.trainer.config.learning_rate)
    monkeypatch.setattr(sweep, "_fly_test_maps", lambda *_: None)
    trials = swept(tmp_path / "sweep", config_of("episodes=10,20", "lr=5e-4,1e-4", early_stopping=False, seeds=1))
    assert {state for _, state, *_ in trials} == {"COMPLETE"}
    trials = swept(tmp_path / "early", config_of("episodes=20", "lr=5e-4,1e-4"))
    assert [(state, max(scores)) for _, state, scores, _ in trials] == [("COMPLETE", 20), ("PRUNED", 10)]


def killed(out: Path, config: sweep.SweepConfig) -> None:
    """Train, and fail in the middle of the second trial as a machine does."""
    report = optuna.trial.Trial.report

    def fail(trial: optuna.trial.Trial, value: float, step: int) -> None:
        report(trial, value, step)
        if trial.number == 1 and step == 20:
            os.kill(os.getpid(), signal.SIGKILL)

    optuna.trial.Trial.report, sweep.CHECKPOINT_SECONDS = fail, 0.0
    sweep.run(out, config, 1)


def test_a_killed_process_changes_nothing(tmp_path: Path) -> None:
    """Another process continues its trial; the networks are those of a sweep without a kill."""
    config = config_of("episodes=40", "lr=1e-3,1e-6", early_stopping=False, seeds=1)
    whole = swept(tmp_path / "whole", config)
    out = tmp_path / "killed"
    process = multiprocessing.get_context("spawn").Process(target=killed, args=(out, config))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL
    assert sweep.write_report(out, config) == {TrialState.COMPLETE: 1, TrialState.RUNNING: 1}
    assert (out / "trial1" / "seed0" / "easy.pth").exists()
    assert swept(out, config) == whole
    for trial in ("trial0", "trial1"):
        folder = out / trial / "seed0"
        assert parameters(folder) == parameters(tmp_path / "whole" / trial / "seed0")
        lines = [line.split()[0] for line in (folder / "train.log").read_text().splitlines()]
        assert lines == [f"episode={n}" for n in range(5, 41, 5)]  # each episode once


def test_two_processes_share_a_sweep_and_a_trial_that_fails_is_reported(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sweep"
    broken = out / "trial1" / "seed1"
    sweep.open_study(out, config := config_of("episodes=20", "lr=1e-3,1e-6"))
    broken.mkdir(parents=True)
    (broken / "easy.pth").write_bytes(b"not a checkpoint")
    sets = [word for text in (*SMALL, "episodes=20", "lr=1e-3,1e-6") for word in ("--set", text)]
    command = ["sweep", "--seeds", "2", *sets, "--test-maps", "20", "--out", str(out), "--processes", "2"]
    assert main(command) == 1
    assert "trials: 1 finished, 0 stopped early, 1 failed" in capfd.readouterr().err
    report = (out / "report.md").read_text()
    finished, failed = (trial.user_attrs for trial in sweep.open_study(out, config).get_trials())
    assert "cut short" in failed["error"]
    assert failed["error"] in report
    assert len(finished["test"]["seed_scores"]) == 2
    assert main([*command[:-1], "1"]) == 1
    assert (out / "report.md").read_text() == report  # nothing is trained again


def test_a_setting_is_set_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sweep", "--set", "gamma=0.9", "--set", "gamma=0.8", "--out", str(tmp_path)]) == 2
    assert "set twice" in capsys.readouterr().err
