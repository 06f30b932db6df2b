"""A training run that takes a moment, and what two runs are compared by."""

from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import nn

from drone_env.rl.config import PpoConfig, TourConfig, TrainConfig
from drone_env.rl.ppo import PpoTrainer
from drone_env.rl.run import TrainingRun
from drone_env.rl.tournet import TourTrainer
from drone_env.rl.trainer import Trainer

SMALL = TrainConfig(
    task="easy",
    episodes=40,
    num_threads=1,
    num_envs=8,
    batch_size=16,
    replay_size=400,
    learning_starts=50,
    steps_per_update=32.0,
    epsilon_steps=500,
    validation_every=10,
    validation_maps=5,
    log_every=5,
    checkpoint_seconds=3600,
)
SMALL_TOUR = TourConfig(
    task="skyline_easy",
    updates=12,
    batch_size=16,
    warm_up=2,
    maps_per_chunk=1,
    states_per_map=8,
    window=3,
    validation_every=5,
    validation_maps=3,
    log_every=2,
    checkpoint_seconds=3600,
)
SMALL_PPO = PpoConfig(
    task="skyline_easy",
    steps=320,
    num_envs=8,
    num_steps=8,
    minibatch_size=16,
    hidden=8,
    validation_every=128,
    validation_maps=3,
    log_every=64,
    checkpoint_seconds=3600,
)
AnyTrainer = TypeVar("AnyTrainer", Trainer, PpoTrainer, TourTrainer)


def run_in(folder: Path, fresh: bool = False, **changes: Any) -> TrainingRun:
    """Such a run with its files in a folder."""
    return TrainingRun(Trainer(replace(SMALL, **changes)), folder, folder / "results", fresh)


def finished(trainer: AnyTrainer) -> AnyTrainer:
    """The trainer at the end of its run."""
    list(trainer.train())
    return trainer


def shared(state: dict[str, Any]) -> dict[str, Any]:
    """All that two equal runs share."""
    times = [state.pop("seconds", 1), state.pop("cpu_seconds"), *(line.pop("cpu_seconds") for line in state["history"])]
    assert min(times) > 0
    return state


def parameters(network: nn.Module) -> list[torch.Tensor]:
    return [parameter.detach().clone() for parameter in network.parameters()]
