"""Learning curves at equal CPU: our trainers, and PPO and MaskablePPO of Stable-Baselines3 and sb3-contrib.

All learn on the same simulator, in one thread, and are validated every few seconds of CPU time, which does not count.
The peers see the raw observation, one-hot planes and telemetry, through a small convolutional network, and learn from
`aligned` with the shaping of their discount. Runs are kept under results/peers, and a run that is there is not
repeated; `drone-env plot results/peers` draws them. With the defaults all runs take an hour of CPU time.
"""

import argparse
import dataclasses
import json
import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn
from training_runs import ROOT

from drone_env.agents.base import ActBatch
from drone_env.agents.custom import Sb3Agent
from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile, profile_for_discount
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.envs.sb3 import DroneDeliveryVecEnv
from drone_env.files import write_text
from drone_env.rl.common import Validator
from drone_env.rl.config import TourConfig, ppo_preset, preset
from drone_env.rl.ppo import PpoTrainer
from drone_env.rl.tournet import TourTrainer
from drone_env.rl.trainer import Trainer

SECONDS = {"easy": 20, "hard": 40, "skyline_easy": 90}
"""CPU seconds of a run; other tasks take those of `skyline_easy`."""
NUM_ENVS = 256
RECIPE = {"n_steps": 32, "batch_size": 1024, "n_epochs": 4, "learning_rate": 1e-3, "ent_coef": 0.01, "gamma": 0.99}
"""The settings of both peers: the best of seven."""
VALIDATION_MAPS, VALIDATIONS = 200, 15
"""Number of validation maps, and of validations in a run."""


class Point(NamedTuple):
    """One validation: CPU seconds and steps before it, ratio to the optimum."""

    seconds: float
    steps: int
    ratio: float


class Watch:
    """Validates an agent every few seconds of CPU time, from the first look on. Validations do not count.

    Args:
        task: The task.
        limit: CPU seconds after which the training ends.
    """

    def __init__(self, task: TaskConfig, limit: float) -> None:
        self.validator, self.limit = Validator(task, VALIDATION_MAPS), limit
        self.curve: list[Point] = []
        self._began, self._next = math.nan, limit / VALIDATIONS

    def look(self, act: ActBatch, steps: int, reset: Callable[[npt.NDArray[np.int64]], None] | None = None) -> bool:
        """Validate if it is due; return whether the training continues."""
        if math.isnan(self._began):
            self._began = time.process_time()
        seconds = time.process_time() - self._began
        if seconds < self._next:
            return True
        validation = self.validator.validate(act, reset)
        self.curve.append(Point(seconds, steps, validation.score / validation.optimum))
        self._began, self._next = time.process_time() - seconds, min(seconds + self.limit / VALIDATIONS, self.limit)
        return seconds < self.limit


class Cells(BaseFeaturesExtractor):
    """Two convolutions of 3 x 3 cells and a dense layer, and the telemetry: float32[B, 128 + telemetry_size]."""

    def __init__(self, observation_space: spaces.Dict) -> None:
        grid, telemetry = observation_space["grid"].shape, observation_space["telemetry"].shape
        assert grid is not None
        assert telemetry is not None
        kinds, height, width = grid
        super().__init__(observation_space, 128 + telemetry[0])
        self.layers = nn.Sequential(
            nn.Conv2d(kinds, 32, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(32, 32, 3, padding=1, stride=2),
            nn.ReLU(),
            nn.Flatten(),
            nn.Linear(32 * ((height + 1) // 2) * ((width + 1) // 2), 128),
            nn.ReLU(),
        )

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """The features of a batch of observations."""
        # Convolutions are fastest on channels last: on skyline_hard an update takes a third less time.
        planes = observations["grid"].contiguous(memory_format=torch.channels_last)
        return torch.cat([self.layers(planes), observations["telemetry"]], dim=1)


class Look(BaseCallback):
    """Shows the policy to a watch after every step."""

    def __init__(self, task: TaskConfig, watch: Watch) -> None:
        super().__init__()
        self._task, self._watch = task, watch

    def _init_callback(self) -> None:
        self._agent = Sb3Agent(self._task, self.model)

    def _on_step(self) -> bool:
        return self._watch.look(self._agent.act_batch, self.num_timesteps)


def ppo(task: TaskConfig, seed: int, watch: Watch) -> None:
    """Our PPO, with the preset of the task."""
    trainer = PpoTrainer(dataclasses.replace(ppo_preset(task.short_name), seed=seed, validation_every=10**9))
    any(not watch.look(trainer.act, trainer.steps) for _ in trainer.train())


def dqn(task: TaskConfig, seed: int, watch: Watch) -> None:
    """Our DQN, with the preset of the task."""
    config = dataclasses.replace(preset("fast", task.short_name), seed=seed, num_threads=1, validation_every=10**9)
    trainer = Trainer(config)
    any(not watch.look(trainer.act, trainer.steps) for _ in trainer.train())


def tournet(task: TaskConfig, seed: int, watch: Watch) -> None:
    """The tour network on this task alone; as many updates as fit into the time, so that the learning rate decays."""
    updates = int(3 * watch.limit)
    config = TourConfig(task=task.short_name, seed=seed, updates=updates, warm_up=updates // 10, validation_every=10**9)
    trainer: Any = TourTrainer(config)
    flyer = trainer._flyers[task.short_name]
    any(not watch.look(flyer.act_batch, trainer.states, flyer.reset_batch) for _ in trainer.train())


def sb3(algorithm: Any, task: TaskConfig, seed: int, watch: Watch) -> None:
    """A learner of Stable-Baselines3 or sb3-contrib."""
    torch.set_num_threads(1)
    rewards = profile_for_discount(get_reward_profile(DEFAULT_PROFILE), 0.99)
    env = DroneDeliveryVecEnv(task, NUM_ENVS, reward_profile=rewards, observation="dict")
    network = {"features_extractor_class": Cells}
    model = algorithm("MultiInputPolicy", env, seed=seed, device="cpu", policy_kwargs=network, **RECIPE)
    model.set_logger(Logger(None, []))  # its own would leave a folder behind for each model
    model.learn(10**12, Look(task, watch))


LEARNERS: dict[str, Callable[[TaskConfig, int, Watch], None]] = {
    "PPO": ppo,
    "DQN": dqn,
    "tournet": tournet,
    "SB3 PPO": partial(sb3, PPO),
    "SB3 MaskablePPO": partial(sb3, MaskablePPO),
}


def run(task: TaskConfig, learner: str, seed: int, watch: Watch, folder: Path) -> tuple[int, float]:
    """Train, unless an earlier run is there; return steps and ratio of its last validation."""
    folder = folder / f"{task.short_name}-{learner.replace(' ', '-')}-{watch.limit:g}s-seed{seed}"
    history = folder / "history.csv"
    if not history.exists():
        LEARNERS[learner](task, seed, watch)
        folder.mkdir(parents=True, exist_ok=True)
        settings = {"algorithm": learner, "task": task.short_name, "seed": seed, "limit": watch.limit}
        text = "".join(f"{name} = {json.dumps(value)}\n" for name, value in settings.items())
        write_text(folder / "config.toml", text)
        lines = [f"{point.seconds},{point.steps},{point.ratio},1" for point in watch.curve]
        write_text(history, "\n".join(["cpu_seconds,steps,validation,validation_optimum", *lines]) + "\n")
    _, steps, ratio, _ = history.read_text(encoding="utf-8").splitlines()[-1].split(",")
    return int(steps), float(ratio)


def main() -> None:
    """Train in turn and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=list(SECONDS))
    parser.add_argument("--learners", nargs="+", default=list(LEARNERS), choices=LEARNERS)
    parser.add_argument("--seeds", type=int, nargs="+", default=range(5))
    parser.add_argument("--cpu-seconds", type=float, help="of each run; the default depends on the task")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "peers")
    arguments = parser.parse_args()
    print("| task | learner | CPU seconds | steps | last ratio: mean | minimum |\n|---|---|---|---|---|---|")
    for name in arguments.tasks:
        task, limit = get_task(name), arguments.cpu_seconds or SECONDS.get(name, SECONDS["skyline_easy"])
        for learner in arguments.learners:
            if learner == "tournet" and task.deliveries == 1:
                continue  # it has nothing to choose
            runs = [run(task, learner, seed, Watch(task, limit), arguments.out.resolve()) for seed in arguments.seeds]
            steps, last = zip(*runs, strict=True)
            print(
                f"| {name} | {learner} | {limit:g} | {np.mean(steps):,.0f} | {np.mean(last):.4f} | {min(last):.4f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
