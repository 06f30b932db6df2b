"""A training run that takes a moment, and what two runs are compared by."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from drone_env.rl.config import TrainConfig
from drone_env.rl.run import TrainingRun
from drone_env.rl.trainer import Trainer

SMALL = TrainConfig(
    task="easy",
    episodes=40,
    num_threads=1,
    num_envs=8,
    batch_size=16,
    replay_size=400,
    learning_starts=50,
    steps_per_update=32,
    epsilon_steps=500,
    validation_every=10,
    validation_maps=5,
    log_every=5,
    checkpoint_seconds=3600,
)


def do_nothing(*_: object) -> None:
    """A callback."""


def run_in(folder: Path, fresh: bool = False, **changes: Any) -> TrainingRun[Trainer]:
    """Such a run with its files in a folder."""
    return TrainingRun(Trainer(replace(SMALL, **changes)), folder, folder / "results", fresh)


def finished(trainer: Trainer) -> Trainer:
    """The trainer at the end of its run."""
    for _ in trainer.train():
        pass
    return trainer


def assert_same(a: Any, b: Any) -> None:
    """Bit for bit, tensors and plain values."""
    if isinstance(a, torch.Tensor):
        assert torch.equal(a, b)
    elif isinstance(a, dict):
        assert a.keys() == b.keys()
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, (list, tuple)):
        assert len(a) == len(b)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        assert a == b or (a != a and b != b)  # NaN is equal to NaN here
