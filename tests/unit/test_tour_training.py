"""A training of the tour network on disk: stopped and gone on with, what is refused, and its command."""

import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from drone_env.agents.tour_network import load_tour_network
from drone_env.cli import main
from drone_env.core.tasks import get_task
from drone_env.errors import InvalidValueError
from drone_env.rl.run import load_checkpoint
from drone_env.rl.samples import SampleGenerator
from drone_env.rl.tournet import TourTrainer
from tests.same import assert_same
from tests.unit.small_training import SMALL_TOUR, finished

# That it goes on


def shared(state: dict[str, Any]) -> dict[str, Any]:
    """All that two equal runs share."""
    times = [state.pop("seconds", 1), state.pop("cpu_seconds"), *(line.pop("cpu_seconds") for line in state["history"])]
    assert min(times) > 0
    return state


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


# The command


TRAIN = [
    "train", "--network", "tournet", "--updates", "4", "--batch-size", "16", "--maps-per-chunk", "1",
    "--states-per-map", "8", "--window", "3", "--warm-up", "2", "--validation-every", "2", "--validation-maps", "3",
    "--log-every", "2",
]  # fmt: skip
EASY = [*TRAIN, "--task", "skyline_easy"]


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
    assert main(["train", "--network", "tournet", "--task", "skyline_easy"]) == 0
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
