"""Sweeps: what is tried, what is stopped, and that nothing is lost or done twice, whatever is killed."""

import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drone_env.cli import main
from drone_env.cluster.sweep.config import SweepConfig, Trial, make_config
from drone_env.cluster.sweep.driver import is_done, outstanding, retry_failed
from drone_env.cluster.sweep.folder import SweepFolder, TrialState
from drone_env.cluster.sweep.halving import decide, remaining, rungs
from drone_env.cluster.sweep.report import sweep_report, write_report
from drone_env.cluster.sweep.settings import settings_of
from drone_env.cluster.sweep.trial import train_trial
from drone_env.commands.arguments import own_profiles_forgotten
from drone_env.core.rewards import REWARD_PROFILES
from drone_env.errors import InvalidValueError, UnknownNameError
from drone_env.results.statistics import SHARES, crossed, interval
from drone_env.rl.config import TrainConfig
from drone_env.rl.dqn import Trainer

SMALL = (
    "num_envs=8", "batch_size=16", "replay_size=400", "learning_starts=50", "steps_per_update=8", "validation_every=10",
    "validation_maps=5", "log_every=5",
)  # fmt: skip


def sweep_of(*sets: str, seeds: int = 1, early_stopping: bool = True) -> SweepConfig:
    return make_config("easy", "fast", settings_of([*SMALL, *sets]), seeds, 1, early_stopping, 20)


# What is tried


def test_a_grid_has_every_combination_with_the_types_of_training() -> None:
    assert settings_of(["lr=1e-3,3e-4", "double=true,false", "loss=mse", "steps-per-update=8"]) == [
        {"learning_rate": lr, "double": double, "loss": "mse", "steps_per_update": 8.0}
        for lr in (1e-3, 3e-4)
        for double in (True, False)
    ]
    assert settings_of([]) == [{}]


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (["speed=1"], "unknown setting 'speed'; allowed: .*batch_size.* lr,"),
        (["batch_size=3.5"], "batch_size cannot be '3.5'"),
        (["loss=l1"], "loss cannot be 'l1'.*'huber' or 'mse'"),
        (["gamma=nan"], "gamma"),
        (["gamma"], "NAME=VALUE"),
        (["gamma=0.9", "gamma=0.8"], "gamma is set twice"),
        (["seed=1"], "--seeds"),
        (["task=hard"], "--task"),
        (["lr=loguniform(1e-5,1e-3)"], "--samples"),
        (["lr=loguniform(0,1e-3)"], "above 0"),
        (["double=uniform(0,1)"], "double"),
        (["gamma=" + ",".join(["0.5"] * 101), "tau=" + ",".join(["0.5"] * 101)], "more than 10000"),
    ],
)
def test_what_cannot_be_set_is_refused(sets: list[str], message: str) -> None:
    with pytest.raises((UnknownNameError, InvalidValueError), match=message):
        settings_of(sets)


def test_rewards_of_ones_own_are_kept_and_known_to_whoever_trains(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text('id = "mine"\nshaping = 0.1\n[events]\ndelivery = 7\n')
    config = sweep_of(f"reward_profile=aligned,{file}")
    folder = SweepFolder(tmp_path / "sweep")
    folder.begin(config)
    before = dict(REWARD_PROFILES)
    with own_profiles_forgotten():
        REWARD_PROFILES.pop("mine", None)  # as on a worker
        assert folder.config().training(Trial(1, 0)).reward_profile == "mine"
        assert REWARD_PROFILES["mine"].terms()["events"] == "delivery 7"
    assert before.keys() == REWARD_PROFILES.keys()
    assert f"--reward-profile {file} " in config.command(Trial(1, 0))
    file.write_text('id = "mine"')
    with own_profiles_forgotten():
        REWARD_PROFILES.pop("mine", None)
        with pytest.raises(InvalidValueError, match=f"rewards of {file}"):
            folder.begin(sweep_of(f"reward_profile=aligned,{file}"))


def test_a_seed_to_draw_by_is_not_negative() -> None:
    with pytest.raises(InvalidValueError, match="--samples-seed must be 0 or more, got -1"):
        settings_of(["lr=loguniform(1e-5,1e-3)"], samples=2, samples_seed=-1)


def test_drawn_settings_lie_in_their_ranges_and_are_the_same_again() -> None:
    texts = ["lr=loguniform(1e-5,1e-3)", "batch_size=uniform(32,64)", "loss=huber,mse"]
    drawn = settings_of(texts, samples=200)
    assert drawn == settings_of(texts, samples=200) != settings_of(texts, samples=200, samples_seed=1)
    rates = np.array([setting["learning_rate"] for setting in drawn], float)
    assert 1e-5 < rates.min() < rates.max() < 1e-3
    assert 0.3 < (rates < 1e-4).mean() < 0.7  # as many in the lower decade as in the upper
    sizes = {setting["batch_size"] for setting in drawn}
    assert all(isinstance(size, int) and 32 <= size <= 64 for size in sizes)
    assert {setting["loss"] for setting in drawn} == {"huber", "mse"}


def test_every_trial_is_checked_before_the_first_is_trained() -> None:
    with pytest.raises(InvalidValueError, match="gamma should be less"):
        sweep_of("gamma=0.9,1.5")
    with pytest.raises(InvalidValueError, match="there twice"):
        sweep_of("lr=1e-3,0.001")
    with pytest.raises(InvalidValueError, match=r"different episodes.*--no-early-stopping"):
        sweep_of("episodes=100,200")
    assert len(sweep_of("episodes=100,200", early_stopping=False).trials()) == 2


def test_the_command_lists_the_trials_and_trains_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "sweep"
    sets = ["--set", "lr=1e-3,3e-4", "--set", "double=false", "--out", str(out)]
    assert main(["sweep", "--task", "easy", "--seeds", "2", *sets, "--dry-run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("\t")[0] for line in lines] == [f"setting{i}-seed{j}" for i in range(2) for j in range(2)]
    assert "--seed 1 --num-threads 1 --learning-rate 0.0003 --no-double" in lines[3]
    assert not out.exists()
    assert main(["sweep", *sets, "--resume"]) == 2
    assert "no sweep in" in capsys.readouterr().err


# What is stopped


def test_the_worse_half_of_the_settings_is_stopped_with_all_its_seeds(tmp_path: Path) -> None:
    config = sweep_of("episodes=100", "lr=1e-3,5e-4,2e-4,1e-4", seeds=3)
    folder = SweepFolder(tmp_path / "sweep")
    folder.begin(config)
    assert rungs(config) == [30, 50]
    # The best seed of all belongs to setting 2, whose mean is not.
    values = {0: (0.5, 0.6, 0.7), 1: (0.2, 0.3, 0.4), 2: (0.1, 0.2, 0.9), 3: (0.5, 0.5, 0.5)}
    for setting, scores in values.items():
        for seed, score in enumerate(scores):
            folder.set_state(Trial(setting, seed), TrialState(rungs={"30": score}))
    decision = decide(folder, config, 30)
    assert decision.stopped == [1, 2]
    assert remaining(config, folder.stopped()) == [0, 3]
    assert {trial.setting for trial in outstanding(folder, config, 50)} == {0, 3}
    # What was decided stands, whatever is known later.
    folder.set_state(Trial(1, 0), TrialState(rungs={"30": 0.99}))
    assert decide(folder, config, 30) == decision
    assert decide(folder, config, 50).stopped == []  # nobody has got there
    assert rungs(sweep_of("episodes=100", "lr=1e-3,5e-4", early_stopping=False)) == []


# What is made of it


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


@pytest.mark.usefixtures("no_curves")
def test_a_trial_that_fails_is_reported_with_its_error_and_counts_in_nothing(tmp_path: Path) -> None:
    config = sweep_of("episodes=20", seeds=2)
    folder = SweepFolder(tmp_path / "sweep")
    folder.begin(config)
    broken = folder.folder(Trial(0, 1))
    broken.mkdir(parents=True)
    (broken / "easy.pth").write_bytes(b"not a checkpoint")
    told: list[dict[str, Any]] = []
    for trial in config.trials():
        told += train_trial(folder.path, 20, 60, trial)
    assert ["cut short" in result["failed"] for result in told if "failed" in result] == [True]
    assert is_done(folder, config)
    figures = sweep_report(folder, config)
    assert figures["trials_by_status"] == {"finished": 1, "stopped": 0, "failed": 1, "unfinished": 0}
    (setting,) = figures["settings"]
    assert (setting["seeds_finished"], setting["seeds_failed"], len(setting["test"]["seed_scores"])) == (1, 1, 1)
    assert "cannot be read: cut short" in figures["trials"][1]["error"]
    write_report(folder, figures)
    text = (folder.path / "report.md").read_text()
    assert "| setting0-seed1 | 0 | drone_env.errors.CheckpointError: " in text
    # It is not tried again unless somebody says so, and what is finished stays as it is.
    finished = folder.state(Trial(0, 0))
    for trial in config.trials():
        assert not list(train_trial(folder.path, 20, 60, trial))
    assert [len(folder.parts(trial)) for trial in config.trials()] == [1, 0]
    retry_failed(folder, config)
    (broken / "easy.pth").unlink()
    assert outstanding(folder, config, 20) == [Trial(0, 1)]
    assert list(train_trial(folder.path, 20, 60, Trial(0, 1)))
    assert folder.state(Trial(0, 1)).status == "finished"
    assert folder.state(Trial(0, 0)) == finished


def test_a_folder_keeps_to_its_sweep(tmp_path: Path) -> None:
    folder = SweepFolder(tmp_path / "sweep")
    folder.begin(sweep_of("gamma=0.9"))
    folder.begin(sweep_of("gamma=0.9"))
    with pytest.raises(
        InvalidValueError, match=r"another configuration: settings: .*0.9.* is now .*0.8.*; seeds: 1 is"
    ):
        folder.begin(sweep_of("gamma=0.8", seeds=2))
    config = folder.path / "sweep.json"
    kept = config.read_text()
    config.write_text(kept.replace('"format_version": 1', '"format_version": 2'))
    with pytest.raises(InvalidValueError, match="format_version"):
        folder.begin(sweep_of("gamma=0.9"))
    config.write_text(kept)
    with folder.driving(), pytest.raises(InvalidValueError, match="another process is driving"), folder.driving():
        pass
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "letter.txt").write_text("dear")
    with pytest.raises(InvalidValueError, match="holds other things"):
        SweepFolder(tmp_path / "other").begin(sweep_of())


def test_the_command_of_a_trial_trains_by_its_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few episodes change the defaults of `train.py`, not what a trial was trained by."""
    asked: list[TrainConfig] = []

    def stop(trainer: Trainer, *_: object) -> None:
        asked.append(trainer.config)
        raise InvalidValueError("seen")

    monkeypatch.setattr("drone_env.rl.run.TrainingRun", stop)
    changed = [{"episodes": 80}, {"episodes": 80, "num_envs": 4}, {"episodes": 5000}, {"tau": 0.5}]
    config = make_config("easy", "fast", changed, 1, 1, False, 20)
    for trial in config.trials():
        assert main(["train", *shlex.split(config.command(trial))[2:]]) == 2
        assert asked[-1].identity() == config.training(trial).identity()
        assert asked[-1].episodes == config.training(trial).episodes
