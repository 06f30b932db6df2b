"""A training run on disk: its checkpoints, its files, the command, and what a kill or Ctrl-C leaves."""

import csv
import math
import signal
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from drone_env.agents.pathqnet import load_network
from drone_env.agents.tour_network import load_tour_network
from drone_env.cli import main
from drone_env.core.tasks import get_task
from drone_env.envs.registry import register_city, register_reward_file
from drone_env.errors import CheckpointError, InvalidValueError
from drone_env.rl import common
from drone_env.rl.config import PpoConfig, TourConfig, TrainConfig
from drone_env.rl.ppo import PpoTrainer
from drone_env.rl.run import DIGITS, TrainingRun, load_checkpoint, log_line, save_checkpoint
from drone_env.rl.samples import SampleGenerator
from drone_env.rl.tournet import TourTrainer
from drone_env.rl.trainer import Progress, Trainer
from tests.same import assert_same
from tests.unit.small_training import SMALL, SMALL_PPO, SMALL_TOUR, finished, run_in, shared

# Checkpoints


@pytest.mark.feature("L5")
def test_a_checkpoint_of_another_run_names_the_difference_and_without_one_it_starts_anew(tmp_path: Path) -> None:
    run_in(tmp_path).save()
    with pytest.raises(CheckpointError, match=r"gamma: 0.99 is now 0.9.*--fresh"):
        run_in(tmp_path, gamma=0.9)
    assert run_in(tmp_path).resumed
    assert not run_in(tmp_path, fresh=True, gamma=0.9).resumed
    (tmp_path / "easy.pth").unlink()
    assert not run_in(tmp_path).resumed


@pytest.mark.feature("L5")
def test_what_starts_again_keeps_every_earlier_training(tmp_path: Path) -> None:
    list(run_in(tmp_path, episodes=10).train())
    checkpoint, network = (tmp_path / f"easy.{kind}" for kind in ("pth", "safetensors"))
    first, exported = checkpoint.read_bytes(), network.read_bytes()
    for seed in (1, 2):
        run = run_in(tmp_path, fresh=True, seed=seed, validation_every=20)
        next(lines := run.train())
        run.save()  # before the first validation
        assert network.read_bytes() == exported  # a server flies it
        lines.close()
    assert Path(f"{checkpoint}.1").read_bytes() == first
    assert load_checkpoint(tmp_path / "easy.pth.2")["config"]["seed"] == 1


@pytest.mark.feature("L5")
@pytest.mark.parametrize(("episodes", "seconds"), [(3, 0), (1, 150)])
def test_checkpoints_are_so_many_episodes_and_seconds_apart_but_for_the_first(
    tmp_path: Path, episodes: int, seconds: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = replace(SMALL, num_envs=1, learning_starts=10_000, episodes=12, checkpoint_episodes=episodes,
                     checkpoint_seconds=seconds)  # fmt: skip
    trainer, kept = Trainer(config), list[tuple[int, int]]()
    monkeypatch.setattr("drone_env.rl.run.monotonic", lambda: trainer.steps)
    run = TrainingRun(trainer, tmp_path, tmp_path)
    monkeypatch.setattr(run, "save", lambda: kept.append((trainer.steps, trainer.episodes)))
    list(run.train())
    assert (kept[0][1], kept[-1]) == (episodes, (trainer.steps, 12))
    assert len(kept) > 3
    for (steps, before), (later, flown) in pairwise(kept[:-1]):
        assert flown - before >= episodes
        assert later - steps >= seconds
        assert seconds or flown - before == episodes


def logged(folder: Path) -> dict[str, list[float]]:
    """The figures of `train.log` by name; NaN where none is known yet."""
    lines = [dict(part.split("=") for part in line.split()) for line in (folder / "train.log").read_text().splitlines()]
    return {name: [math.nan if line[name] == "-" else float(line[name]) for line in lines] for name in lines[0]}


@pytest.mark.feature("L6")
def test_maps_whose_optimum_is_not_known_are_trained_on_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(common, "best_of", lambda *_: None)
    run = run_in(tmp_path, episodes=10)
    list(run.train())
    assert math.isnan(logged(tmp_path)["optimum"][-1])
    assert load_network(run.network).metadata["validation_optimum"] is None
    assert run_in(tmp_path, episodes=10).trainer.episodes == run.trainer.episodes


def test_the_log_grows_and_begins_anew_with_what_the_checkpoint_holds(tmp_path: Path) -> None:
    run, log = run_in(tmp_path, episodes=10), tmp_path / "train.log"
    assert [log.read_text().count("\n") for _ in run.train()] == [1, 2][: len(run.trainer.history)]
    first = [log_line(line) for line in run.trainer.history]
    assert log.read_text().splitlines() == first
    with log.open("a") as unsaved:
        unsaved.write("flown after the checkpoint\n")
    run = run_in(tmp_path, episodes=15)
    list(run.train())
    assert log.read_text().splitlines() == [*first, log_line(run.trainer.history[-1])]
    run = run_in(tmp_path, fresh=True, episodes=10)
    list(run.train())
    assert log.read_text().splitlines() == [log_line(line) for line in run.trainer.history]


@pytest.mark.feature("L5")
def test_two_cannot_train_in_one_folder(tmp_path: Path) -> None:
    first, second = run_in(tmp_path), run_in(tmp_path)
    next(lines := first.train())
    first.save()
    kept = first.checkpoint.read_bytes()
    for other in (second, run_in(tmp_path, fresh=True), run_in(tmp_path, seed=1, task="medium")):
        with pytest.raises(InvalidValueError, match=r"another process is training in .*: .*add --data FOLDER"):
            next(other.train())
    assert first.checkpoint.read_bytes() == kept
    lines.close()
    assert next(run_in(tmp_path, fresh=True).train()).episode >= 5


def test_weights_that_are_no_numbers_are_not_saved(tmp_path: Path) -> None:
    run = run_in(tmp_path)
    run.save()
    kept = run.checkpoint.read_bytes()
    next(run.trainer.online.parameters()).data[0] = math.nan
    with pytest.raises(InvalidValueError, match=r"(?s)diverged.*Lower --learning-rate"):
        run.save()
    assert run.checkpoint.read_bytes() == kept


def test_a_file_that_is_no_checkpoint_is_said_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "easy.pth"
    save_checkpoint(path, {"tensor": torch.zeros(1000)})
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"not a checkpoint"):
        path.write_bytes(content)
        # PyTorch's own message advises to load it with the right to run code.
        with pytest.raises(CheckpointError, match=r"easy\.pth cannot be read: cut short, or no checkpoint \(\w+\)$"):
            load_checkpoint(path)
        assert path.read_bytes() == content
    with pytest.raises(CheckpointError, match="--fresh"):
        run_in(tmp_path)
    assert path.read_bytes() == content
    torch.save({"weights": torch.zeros(3)}, path)
    with pytest.raises(CheckpointError, match="not a checkpoint of this project"):
        load_checkpoint(path)
    save_checkpoint(path, {"config": SMALL.identity()})
    with pytest.raises(CheckpointError, match=r"easy\.pth does not fit: 'online'; --fresh"):
        run_in(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["easy.pth"]


def test_a_checkpoint_that_could_run_code_is_not_loaded(tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "evil.pth", {"code": Path.home})
    with pytest.raises(CheckpointError, match="no checkpoint \\(UnpicklingError"):
        load_checkpoint(tmp_path / "evil.pth")


# The command


TRAIN = [
    "train", "--task", "easy", "--episodes", "40", "--num-threads", "1", "--num-envs", "8", "--batch-size", "16",
    "--replay-size", "400", "--learning-starts", "50", "--steps-per-update", "32", "--validation-every", "10",
    "--validation-maps", "5", "--log-every", "5",
]  # fmt: skip


def test_the_command_trains_and_leaves_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)

    def trained(*more: str) -> tuple[int, str]:
        status = main(["train", *more])
        captured = capsys.readouterr()
        assert captured.out == ""
        return status, captured.err

    status, told = trained(*TRAIN[1:])
    assert status == 0
    assert "on the validation maps" in told
    state = load_checkpoint(tmp_path / "data/easy.pth")
    for name, curve in logged(tmp_path / "data").items():
        figures = [line["validation_optimum" if name == "optimum" else name] for line in state["history"]]
        assert curve == pytest.approx(figures, abs=10.0 ** -DIGITS.get(name, 4), nan_ok=True), name
    history = list(csv.DictReader((tmp_path / "results/easy/history.csv").read_text().splitlines()))
    for row, line in zip(history, state["history"], strict=True):
        assert {name: float(value) for name, value in row.items()} == pytest.approx(line, rel=0, nan_ok=True)
    (events,) = (tmp_path / "results/easy/tensorboard").glob("events.*")
    assert [field.name for field in fields(Progress)[1:] if field.name.encode() not in events.read_bytes()] == []
    # The exported network is the best one, with its origin.
    network = load_network(tmp_path / "data/easy.safetensors")
    assert_same({name: torch.from_numpy(array) for name, array in network.parameters.items()}, dict(state["best"]))
    expected = {"task": "easy_delivery", **{name: state[name] for name in ("episodes", "steps", "updates")}}
    assert {name: network.metadata[name] for name in expected} == expected
    # A finished training continues with more episodes, its other settings are the defaults of the next command.
    done = state["episodes"]  # the last step may end more than were wanted
    assert 40 <= done < 48
    assert f"has {done} of 20 episodes: nothing to do" in trained("--episodes", "20")[1]
    status, told = trained("--episodes", "50")
    assert f"going on from data/easy.pth: {done} of 50 episodes" in told
    assert load_checkpoint(tmp_path / "data/easy.pth")["config"] == state["config"]


@pytest.mark.feature("L4")
@pytest.mark.parametrize(("algorithm", "config", "other"), [("dqn", TrainConfig, "--maps-per-chunk"),
                                                            ("ppo", PpoConfig, "--episodes"),
                                                            ("tournet", TourConfig, "--preset")])  # fmt: skip
def test_every_value_is_a_flag(algorithm: str, config: Any, other: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["train", "--algorithm", algorithm, "--help"])
    shown = capsys.readouterr().out
    assert [field.name for field in fields(config) if f"--{field.name.replace('_', '-')}" not in shown] == []
    assert other not in shown


# The file of settings

HOME = 'format = 1\n[task]\ndeliveries = 1\n[terrain]\nrows = ["🏢· · · ", "· 🌳· · ", "· · · · "]\n'
MINE = 'id = "mine"\npays_score = true\n[events]\ndelivery = 1.0\n'


@pytest.mark.parametrize(
    ("make", "config"),
    [
        (Trainer, replace(SMALL, seed=3, double=False, gamma=1.0)),
        (PpoTrainer, replace(SMALL_PPO, steps=64, learning_rate=3e-5)),
        (TourTrainer, replace(SMALL_TOUR, updates=3)),
    ],
)
def test_the_settings_beside_a_run_repeat_it_bit_for_bit(
    make: Any, config: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if make is Trainer:  # on a map and for a reward of one's own
        Path("home.toml").write_text(HOME, encoding="utf-8")
        Path("mine.toml").write_text(MINE, encoding="utf-8")
        task, profile = register_city("home.toml").id, register_reward_file("mine.toml").id
        config = replace(config, task=task, reward_profile=profile)
    list(TrainingRun(make(config), Path("a"), Path("a")).train())
    settings = Path("a", config.name, "config.toml")
    assert main(["train", "--config", str(settings), "--data", "b", "--results", "b"]) == 0
    first, second = (shared(load_checkpoint(Path(folder, f"{config.name}.pth"))) for folder in "ab")
    assert_same(first, second)
    networks = [Path(folder, f"{config.name}.safetensors").read_bytes() for folder in "ab"]
    assert networks[0] == networks[1]
    # The command line wins: the checkpoint of the other seed does not fit.
    assert main(["train", f"--config={settings}", "--seed", "8", "--data", "b", "--results", "b"]) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('algorithm = "sac"', "unknown algorithm 'sac'; allowed: dqn, ppo, tournet"),
        ("learning-rate = 1", "unknown setting of dqn 'learning-rate'; did you mean 'learning_rate'?"),
        ('algorithm = "ppo"\nepisodes = 3', "unknown setting of ppo 'episodes'"),
        ('algorithm = "ppo"\npreset = "fast"', "unknown setting of ppo 'preset'"),
        ("[ppo]\nseed = 3", "unknown setting of dqn 'ppo'"),
        ('seed = "3"', "seed should be a valid integer, got '3'"),
        ("double = 1", "double should be a valid boolean, got 1"),
        ("gamma = 1.5", "gamma should be less than or equal to 1, got 1.5"),
        ("seed =", "invalid TOML: Invalid value"),
    ],
)
def test_a_file_of_settings_that_is_wrong_is_named_with_the_reason(
    text: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.toml").write_text(text)
    assert main(["train", "--config", str(tmp_path / "run.toml"), "--data", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith(f"drone-env: {tmp_path / 'run.toml'}: {message}")


def test_a_killed_run_leaves_the_table_of_its_checkpoint(tmp_path: Path) -> None:
    run = run_in(tmp_path, checkpoint_seconds=0, checkpoint_episodes=0)
    lines = run.train()
    assert [next(lines).episode for _ in range(3)]
    table = (run.results / "history.csv").read_text().splitlines()
    assert len(table) == 1 + len(load_checkpoint(run.checkpoint)["history"]) > 2


# The tour network


def test_samples_without_a_choice_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    empty = SampleGenerator(get_task("easy"), 2, 8).generate(np.arange(2))
    monkeypatch.setattr(SampleGenerator, "generate", lambda *_: empty)
    trainer = TourTrainer(SMALL_TOUR)
    with pytest.raises(InvalidValueError, match="no sample has options of different value: raise maps_per_chunk"):
        next(trainer.train())


def test_a_training_that_diverges_ends_with_the_reason() -> None:
    with pytest.raises(InvalidValueError, match=r"loss NaN after \d updates: lower learning_rate"):
        finished(TourTrainer(replace(SMALL_TOUR, learning_rate=1e30, warm_up=0, validation_every=100)))


def test_how_often_it_is_saved_and_how_the_task_is_called_makes_no_other_run() -> None:
    same = replace(SMALL_TOUR, task=get_task("skyline_easy").grader, checkpoint_seconds=1)
    assert same.identity() == SMALL_TOUR.identity() != replace(same, updates=13).identity()


TOUR = [
    "train", "--algorithm", "tournet", "--updates", "4", "--batch-size", "16", "--maps-per-chunk", "1",
    "--states-per-map", "8", "--window", "3", "--warm-up", "2", "--validation-every", "2", "--validation-maps", "3",
    "--log-every", "2",
]  # fmt: skip
EASY = [*TOUR, "--task", "skyline_easy"]


def test_interrupted_it_saves_and_goes_on_to_the_same_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    learn, interrupts = TourTrainer._update, [1, 3]

    def learn_and_interrupt(trainer: TourTrainer) -> None:
        learn(trainer)
        if trainer.updates in interrupts:
            interrupts.remove(trainer.updates)
            signal.raise_signal(signal.SIGINT)  # as Ctrl-C does

    monkeypatch.setattr(TourTrainer, "_update", learn_and_interrupt)
    file = "tournet_skyline_easy.pth"
    for update in (1, 3):  # before the first line of the log, and between two
        assert main([*EASY, *(["--fresh"] if update == 1 else [])]) == 130
        told = capsys.readouterr().err
        without = " without --fresh" if update == 1 else ""
        assert f"stopped after {update} updates, saved as data/{file}; the same command{without} goes on\n" in told
        # Of a network that was not validated, a server flies nothing.
        assert (tmp_path / "data" / file).with_suffix(".safetensors").exists() == (update == 3)
    # What is not said is as it was.
    assert main(["train", "--algorithm", "tournet", "--task", "skyline_easy"]) == 0
    assert f"going on from data/{file}: 3 of 4 updates" in capsys.readouterr().err
    assert main([*EASY, "--data", "whole", "--results", "whole"]) == 0
    state = load_checkpoint(tmp_path / "data" / file)
    assert_same(shared(load_checkpoint(tmp_path / "whole" / file)), shared(dict(state)))
    # The exported network is the validated average, with its origin.
    network = load_tour_network(tmp_path / "data/tournet_skyline_easy.safetensors")
    assert_same({name: torch.from_numpy(array) for name, array in network.parameters.items()}, dict(state["average"]))
    expected = {"network": "tournet", "tasks": {"skyline_easy": 2}, "updates": 4, "states": 64}
    expected |= {"validation_shares": state["ratios"], "config": state["config"]}
    assert {name: network.metadata[name] for name in expected} == expected
