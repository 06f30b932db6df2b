"""A training run on disk: its checkpoints, its files, the command, and what a kill or Ctrl-C leaves."""

import csv
import io
import itertools
import json
import math
import os
import random
import re
import signal
import subprocess
import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from shutil import rmtree
from textwrap import wrap
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from fastapi.testclient import TestClient
from rich.cells import cell_len
from rich.console import Console

from drone_env.agents.pathqnet import load_network
from drone_env.cli import main
from drone_env.commands.train import Live
from drone_env.core.seeds import split_seeds
from drone_env.errors import CheckpointError, InvalidValueError
from drone_env.rl import common
from drone_env.rl.config import ORIGINAL, TrainConfig, preset
from drone_env.rl.dqn import Progress, Trainer
from drone_env.rl.run import DIGITS, MOST_KEPT, TrainingRun, load_checkpoint, log_line, summary
from drone_env.rl.tour_config import TourConfig
from drone_env.server.app import create_app
from drone_env.server.logs import TrainLog
from drone_env.server.settings import Settings
from tests.unit.small_training import SMALL, assert_same, run_in

ROOT = Path(__file__).parents[2]
KILLS = 20 if int(os.environ.get("DRONE_ENV_EXAMPLES", "0")) >= 10_000 else 1


# Checkpoints


@pytest.mark.feature("L5")
def test_a_checkpoint_of_another_run_names_the_difference_and_without_one_it_starts_anew(tmp_path: Path) -> None:
    run_in(tmp_path).save()
    assert run_in(tmp_path).resumed
    with pytest.raises(CheckpointError, match=r"gamma 0.99 \(now 0.9\).*--fresh"):
        run_in(tmp_path, gamma=0.9)
    assert not run_in(tmp_path, fresh=True, gamma=0.9).resumed
    (tmp_path / "easy.pth").unlink()
    assert not run_in(tmp_path).resumed


@pytest.mark.feature("L5")
@pytest.mark.usefixtures("no_curves")
def test_what_starts_again_keeps_every_earlier_training_until_there_are_too_many(tmp_path: Path) -> None:
    list(run_in(tmp_path, episodes=10).train())
    checkpoint, network = tmp_path / "easy.pth", tmp_path / "easy.safetensors"
    first = {file: file.read_bytes() for file in (checkpoint, network)}
    for number in range(1, MOST_KEPT + 1):
        run = run_in(tmp_path, fresh=True, seed=number, validation_every=20)
        next(lines := run.train())
        run.save()  # before the first validation
        assert network.read_bytes() == first[network]  # what a server flies
        lines.close()
    assert [Path(f"{file}.1").read_bytes() for file in first] == list(first.values())
    assert load_checkpoint(tmp_path / "easy.pth.2")["config"]["seed"] == 1
    assert (tmp_path / "results/easy.1/history.csv").exists()
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InvalidValueError, match=r"easy\.pth\.1 to \.9 are kept already: move or delete"):
        next(run_in(tmp_path, fresh=True).train())
    assert sorted(tmp_path.rglob("*")) == before
    # The network of an earlier training is kept even without its checkpoint.
    for name in ("easy.pth", "easy.pth.9", "easy.safetensors.9"):
        (tmp_path / name).unlink()
    rmtree(tmp_path / "results/easy.9")
    list(run_in(tmp_path, episodes=10, seed=1).train())
    assert (tmp_path / "easy.safetensors.9").read_bytes() == first[network] != network.read_bytes()


@pytest.mark.feature("L5")
@pytest.mark.usefixtures("no_curves")
def test_checkpoints_are_so_many_episodes_and_seconds_apart_but_for_the_first(tmp_path: Path) -> None:
    def saved(episodes: int, seconds: float) -> list[tuple[int, int]]:
        """The (steps, episodes) of each checkpoint; the clock counts steps."""
        config = replace(SMALL, num_envs=1, learning_starts=10_000, episodes=20, checkpoint_episodes=episodes,
                         checkpoint_seconds=seconds)  # fmt: skip
        trainer, place, kept = Trainer(config), tmp_path / f"{episodes} {seconds}", list[tuple[int, int]]()
        run = TrainingRun(trainer, place, place, clock=lambda: trainer.steps)
        run.save = lambda: kept.append((trainer.steps, trainer.episodes))  # type: ignore[method-assign]
        list(run.train())
        return kept

    steps = sorted(set(saved(0, 0)))
    assert [flown for flown, _ in steps] == list(range(1, steps[-1][0] + 1))
    for episodes, seconds in ((6, 0), (2, 300)):
        expected: list[tuple[int, int]] = []
        for flown, ended in steps:
            late = not expected or flown - expected[-1][0] >= seconds
            if late and ended - (expected[-1][1] if expected else 0) >= episodes:
                expected.append((flown, ended))
        assert len(expected) > 1
        assert saved(episodes, seconds) == [*expected, steps[-1]]


@pytest.mark.feature("L5")
def test_what_the_log_has_told_is_not_lost_by_a_kill(tmp_path: Path) -> None:
    """With the settings of `train.py --episodes 500`, except for slow ones."""
    config = replace(preset("fast", "easy", 500), validation_maps=5, validation_every=500, steps_per_update=1e9)
    for line in TrainingRun(Trainer(config), tmp_path, tmp_path / "results").train():
        if line.episode >= 60:
            break  # like a kill: nothing is saved
    assert TrainingRun(Trainer(config), tmp_path, tmp_path / "results").trainer.episodes >= 50


@pytest.mark.feature("L6")
def test_maps_whose_optimum_is_not_known_are_trained_on_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, no_curves: None
) -> None:
    known, seeds = common.best_of, split_seeds("validation", SMALL.validation_maps)
    monkeypatch.setattr(common, "best_of", lambda task, seed: None if seed == seeds[1] else known(task, seed))
    run = run_in(tmp_path, episodes=10)
    (*_, last) = run.train()
    assert log_line(last).endswith(" optimum=-")
    assert summary(last).startswith(f"validation {last.validation:.4f} of -")
    assert run.trainer.result.endswith(" of -")
    assert TrainLog(tmp_path).curve()["optimum"][-1] is None
    assert load_network(run.network).metadata["validation_optimum"] is None
    assert run_in(tmp_path, episodes=10).trainer.episodes == run.trainer.episodes


@pytest.mark.usefixtures("no_curves")
def test_the_log_grows_and_begins_anew_with_what_the_checkpoint_holds(tmp_path: Path) -> None:
    run, log = run_in(tmp_path, episodes=10), tmp_path / "train.log"
    lengths = [log.read_text().count("\n") for _ in run.train()]
    assert lengths == [1, 2]
    first = [log_line(line) for line in run.trainer.history]
    with log.open() as follower:  # like `tail -f`
        assert follower.read().splitlines() == first
        with log.open("a") as unsaved:
            unsaved.write("flown after the checkpoint\n")
        run = run_in(tmp_path, episodes=15)
        list(run.train())
        last = log_line(run.trainer.history[-1])
        assert follower.read() == f"{last}\n"
        assert log.read_text().splitlines() == [*first, last]
        # A training from scratch empties the file before its first episode.
        run = run_in(tmp_path, fresh=True, episodes=10)
        fly, seen = run.trainer.fly, list[str]()

        def look_and_fly() -> None:
            follower.seek(0)
            seen.append(follower.read())
            fly()

        run.trainer.fly = look_and_fly  # type: ignore[method-assign]
        list(run.train())
        follower.seek(0)
        assert (seen[0], follower.read().count("\n")) == ("", 2)


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
    late = run_in(tmp_path)  # it has read the checkpoint that the first replaces
    first.save()
    lines.close()
    with pytest.raises(InvalidValueError, match=r"another process has trained in .* meanwhile"):
        next(late.train())
    assert next(run_in(tmp_path, fresh=True).train()).episode == 5


def test_weights_that_are_no_numbers_are_not_saved(tmp_path: Path) -> None:
    run = run_in(tmp_path)
    run.save()
    kept = run.checkpoint.read_bytes()
    next(run.trainer.online.parameters()).data[0] = math.nan
    with pytest.raises(InvalidValueError, match=r"(?s)diverged.*Lower --learning-rate"):
        run.save()
    assert run.checkpoint.read_bytes() == kept


def test_interrupted_twice_it_ends_at_once(tmp_path: Path) -> None:
    before, run, asked = signal.getsignal(signal.SIGINT), run_in(tmp_path), list[bool]()

    def train() -> None:
        with run.stopping_on_interrupt():
            for _ in run.train():
                for _ in range(2):
                    asked.append(run.stopped)
                    signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        train()
    assert asked == [False, True]
    assert not run.checkpoint.exists()
    assert signal.getsignal(signal.SIGINT) is before


# The command


TRAIN = [
    "train", "--task", "easy", "--episodes", "40", "--num-threads", "1", "--num-envs", "8", "--batch-size", "16",
    "--replay-size", "400", "--learning-starts", "50", "--steps-per-update", "32", "--validation-every", "10",
    "--validation-maps", "5", "--log-every", "5",
]  # fmt: skip


def test_the_command_trains_and_leaves_what_it_says(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    request: pytest.FixtureRequest,
) -> None:
    monkeypatch.chdir(tmp_path)

    def trained(*more: str) -> tuple[int, str]:
        status = main([*TRAIN, *more] if not more or more[0] != "train" else list(more))
        captured = capsys.readouterr()
        assert captured.out == ""
        return status, captured.err

    status, told = trained()
    assert status == 0
    assert "on the validation maps" in told
    log = (tmp_path / "data/train.log").read_text().splitlines()
    assert [line.split()[0] for line in log] == [f"episode={n}" for n in range(5, 41, 5)]
    state = load_checkpoint(tmp_path / "data/easy.pth")
    for name, curve in TrainLog(tmp_path / "data").curve().items():
        figures = [line["validation_optimum" if name == "optimum" else name] for line in state["history"]]
        assert [math.nan if at is None else at for at in curve] == pytest.approx(
            figures, abs=10.0 ** -DIGITS.get(name, 4), nan_ok=True
        ), name
    history = list(csv.DictReader((tmp_path / "results/easy/history.csv").read_text().splitlines()))
    for row, line in zip(history, state["history"], strict=True):
        assert {name: float(value) for name, value in row.items()} == pytest.approx(line, rel=0, nan_ok=True)
    for name in ("reward", "length", "loss", "epsilon", "validation"):
        assert (tmp_path / f"results/easy/{name}.png").read_bytes().startswith(b"\x89PNG")
    request.getfixturevalue("no_curves")
    (events,) = (tmp_path / "results/easy/tensorboard").glob("events.*")
    assert [field.name for field in fields(Progress)[1:] if field.name.encode() not in events.read_bytes()] == []
    # The exported network is the best one, with its origin.
    network = load_network(tmp_path / "data/easy.safetensors")
    assert_same({name: torch.from_numpy(array) for name, array in network.parameters.items()}, dict(state["best"]))
    expected = {"task": "easy_delivery", **{name: state[name] for name in ("episodes", "steps", "updates")}}
    expected["validation_score"] = state["best_score"]
    assert {name: network.metadata[name] for name in expected} == expected
    assert main(["evaluate", "--task", "easy", "--agents", "pathqnet", "--checkpoint", "data/easy.safetensors",
                 "--episodes", "20", "--json", "-"]) == 0  # fmt: skip
    assert "pathqnet:data/easy.safetensors" in json.loads(capsys.readouterr().out)["tasks"]["easy_delivery"]["agents"]
    with TestClient(create_app(Settings(data=tmp_path / "data"))) as http:
        http.post("/reset", json={"seed": 7})
        model = http.post("/predict").json()["model"]
    assert (model["file"], model["digest"]) == ("easy.safetensors", network.digest)
    # A finished training continues with more episodes.
    written = (tmp_path / "data/easy.pth").read_bytes()
    status, told = trained("train", "--episodes", "20")
    assert status == 0
    assert "easy.pth has 40 of 20 episodes: nothing to do.\nAdd --episodes 80 to go on. Add --fresh to start" in told
    assert (tmp_path / "data/easy.pth").read_bytes() == written
    status, told = trained("--episodes", "50")
    assert "going on from data/easy.pth: 40 of 50 episodes" in " ".join(told.split())
    assert len((tmp_path / "data/train.log").read_text().splitlines()) == 10
    # Its other settings are the defaults of the next command.
    assert trained("train", "--episodes", "55")[0] == 0
    assert load_checkpoint(tmp_path / "data/easy.pth")["config"] == state["config"]
    status, told = trained("train", "--episodes", "60", "--preset", "original")
    assert status == 2
    assert "num_envs 8 (now 1) and 17 more; use those" in told
    assert len(wrap(told, 80)) <= 2


@pytest.mark.usefixtures("no_curves")
def test_the_standard_tasks_are_trained_one_after_another(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    places = ["--data", str(tmp_path / "data"), "--results", str(tmp_path / "results")]
    few = [*TRAIN[3:], "--episodes", "2", "--validation-maps", "1"]
    assert main(["train", "--task", "standard", *few, *places]) == 0
    for task in ("easy", "medium", "hard"):
        assert load_checkpoint(tmp_path / f"data/{task}.pth")["config"]["task"] == f"{task}_delivery"
    # The first failure ends it.
    (tmp_path / "data/easy.pth").write_bytes(b"nothing")
    capsys.readouterr()
    assert main(["train", "--task=standard", *few, *places]) == 2
    told = capsys.readouterr().err
    assert "easy.pth" in told
    assert "medium" not in told


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--resume", "--fresh"], "one of them"),
        (["--resume"], "there is no checkpoint"),
        (["--episodes", "0"], "episodes should be greater than 0"),
        (["--task", "impossible"], "allowed: "),
        (["--task", "all"], "Type --task standard (easy, medium, hard), or add --network tournet."),
        (["--reward-profile", "generous"], "allowed: aligned"),
        (["--learning-rate", "inf"], "learning_rate should be a finite number"),
        (["--replay-size", "1000000000000000"], "Lower the sizes that you set, such as --replay-size"),
        (["--network", "tournet", "--resume", "--fresh"], "one of them"),
        (["--network", "tournet", "--resume", "--validation-maps", "1", "--task", "medium"], "there is no checkpoint"),
        (["--network", "tournet", "--task", "easy"], "there is nothing to choose"),
        (["--network", "tournet", "--batch-size", "10"], "batch_size should be a multiple of 4"),
        (["--network", "tournet", "--preset", "original"], "--preset"),
    ],
)
def test_the_command_refuses(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["train", *arguments]) == 2
    assert message in "".join(capsys.readouterr())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.feature("L4")
@pytest.mark.parametrize(("network", "config", "other"), [("pathqnet", TrainConfig, "--maps-per-chunk"),
                                                          ("tournet", TourConfig, "--preset")])  # fmt: skip
def test_every_value_is_a_flag(network: str, config: Any, other: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["train", "--network", network, "--help"])
    shown = capsys.readouterr().out
    assert [field.name for field in fields(config) if f"--{field.name.replace('_', '-')}" not in shown] == []
    assert "--network {pathqnet,tournet}" in shown
    assert other not in shown


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("columns", [80, 120])
def test_the_bar_shows_the_episode_the_time_and_the_validation(columns: int) -> None:
    run, shown = SimpleNamespace(name="hard", done=60, total=1000), Terminal()
    console = Console(file=shown, width=columns, force_terminal=True, color_system=None)
    ticks = itertools.count()
    figures = "validation 0.9561 of 0.9774  loss 0.0310  epsilon 0.52  12345 steps/s"
    with Live(run, console, lambda: next(ticks)) as progress:  # type: ignore[arg-type]
        progress.update(progress.bar, figures=figures)
        for run.done in (100, 130):
            progress.refresh()
    last = re.sub(r"\x1b\[[^a-zA-Z]*[a-zA-Z]", "", shown.getvalue()).rstrip("\n").rpartition("\r")[2]
    assert cell_len(last) <= columns
    assert re.search(r"hard +130/1000 \d:\d\d:\d\d ", last)
    assert (figures if columns == 120 else figures[:27]) in last


ORIGINALS = [
    "--task", "easy_delivery", "--preset", "original", "--num-envs", "8", "--steps-per-update", "64",
    "--validation-maps", "5", "--num-threads", "1",
]  # fmt: skip
"""The original's hyperparameters, except for speed."""


@contextmanager
def training(folder: Path) -> Generator["subprocess.Popen[bytes]", None, None]:
    """`train.py` in a process that would not end by itself; it is killed in the end."""
    folder.mkdir(exist_ok=True)
    command = [sys.executable, str(ROOT / "train.py"), *ORIGINALS, "--episodes", "1000000"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with (folder / "output").open("ab") as output:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=output, stderr=output)
        try:
            yield process
        finally:
            process.kill()
            process.wait()


@pytest.mark.feature("L4", "L5")
@pytest.mark.usefixtures("no_curves")
def test_killed_it_goes_on_and_comes_to_the_same_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """At random moments after a checkpoint, once or many times; bit for bit the run that was never killed."""
    killed, rng = tmp_path / "killed", random.Random(KILLS)
    checkpoint, log, saved = killed / "data/easy.pth", killed / "data/train.log", 0
    for _ in range(KILLS):
        with training(killed) as process:
            deadline = time.monotonic() + 120
            while not checkpoint.exists() or checkpoint.stat().st_mtime_ns == saved:
                assert process.poll() is None, (killed / "output").read_text()
                assert time.monotonic() < deadline, (killed / "output").read_text()
                time.sleep(0.005)
            if KILLS > 1:  # anywhere up to the next checkpoint, or within it
                time.sleep(rng.uniform(0, 1))
        saved = checkpoint.stat().st_mtime_ns
    assert process.returncode == -signal.SIGKILL

    state = load_checkpoint(checkpoint)
    flown = state["episodes"]
    assert flown >= 50
    short = {"num_envs": 1, "steps_per_update": 1, "validation_maps": 500, "num_threads": 2}
    assert state["config"] | short == ORIGINAL.identity()
    runs = {}
    for name in ("killed", "whole"):
        (tmp_path / name).mkdir(exist_ok=True)
        monkeypatch.chdir(tmp_path / name)
        assert main(["train", *ORIGINALS, "--episodes", str(flown + 10)]) == 0
        told = " ".join(capsys.readouterr().err.split())
        assert (f"going on from data/easy.pth: {flown} of {flown + 10}" in told) == (name == "killed")
        runs[name] = load_checkpoint(tmp_path / name / "data/easy.pth")
        assert runs[name].pop("seconds") > 0
    assert_same(runs["whole"], runs["killed"])
    assert (tmp_path / "whole/data/train.log").read_bytes() == log.read_bytes()
