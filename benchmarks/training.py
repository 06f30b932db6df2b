"""How soon our trainer and Stable-Baselines3's DQN fly near the optimum.

Both learn on the same simulator with the same network, reward and validation maps, in turn, in one run. Every few
seconds of CPU time the network is validated, which does not count. The table shows when its mean score first reached
each ratio to the mean exact optimum. `SB3` contains the settings of Stable-Baselines3, the best of those tried.
"""

import argparse
import dataclasses
import math
import platform
import time
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from drone_env.agents.base import ActBatch
from drone_env.core.tasks import get_task
from drone_env.envs.forms import one_hot
from drone_env.envs.sb3 import DroneDeliveryVecEnv
from drone_env.rl.common import Validator
from drone_env.rl.config import preset
from drone_env.rl.model import PathQNet
from drone_env.rl.trainer import Trainer

RATIOS = (0.95, 0.99, 0.995)
NUM_ENVS = 512
SB3: dict[str, Any] = {
    "learning_rate": 1e-3,
    "buffer_size": 200_000,
    "learning_starts": 5_000,
    "batch_size": 256,
    "tau": 0.15,
    "target_update_interval": NUM_ENVS,
    "train_freq": 1,
    "gradient_steps": 8,
    "gamma": 0.99,
    "exploration_fraction": 0.15,
    "exploration_final_eps": 0.2,
    "max_grad_norm": 10,
}
SB3_STEPS = 400_000


class Point(NamedTuple):
    """One validation: CPU seconds and steps before it, ratio to the optimum, share of maps with all delivered."""

    seconds: float
    steps: int
    ratio: float
    success: float


class Watch:
    """Validates an agent every few seconds of CPU time, from the first look on. Validations do not count.

    Args:
        validator: Flies the maps.
        limit: CPU seconds after which the training ends.
        until: Ratio at which the training ends.
        every: CPU seconds between two validations.
    """

    def __init__(self, validator: Validator, limit: float, until: float = math.inf, every: float = 2.0) -> None:
        self.validator, self.limit, self.until, self.every = validator, limit, until, every
        self.curve: list[Point] = []
        self._began, self._next = math.nan, every

    def look(self, act: ActBatch, steps: int) -> bool:
        """Validate if it is due; return whether the training continues."""
        if math.isnan(self._began):
            self._began = time.process_time()
        seconds = time.process_time() - self._began
        if seconds < self._next:
            return True
        validation = self.validator.validate(act)
        self.curve.append(Point(seconds, steps, validation.score / validation.optimum, validation.success))
        self._began, self._next = time.process_time() - seconds, min(seconds + self.every, self.limit)
        return self.curve[-1].ratio < self.until and seconds < self.limit


class PathQNetFeatures(BaseFeaturesExtractor):
    """PathQNet without its last layer, which Stable-Baselines3 adds."""

    def __init__(self, observation_space: spaces.Dict) -> None:
        telemetry = observation_space["telemetry"].shape
        assert telemetry is not None
        network = PathQNet(telemetry[0])
        last = network.head[-1]
        assert isinstance(last, nn.Linear)
        super().__init__(observation_space, last.in_features)
        network.head[-1] = nn.Identity()
        self.network = network

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features, float32[B, 64], from one-hot planes and telemetry."""
        return self.network(observations["grid"].argmax(1), observations["telemetry"])


class Look(BaseCallback):
    """Shows the network to a watch after every step."""

    def __init__(self, watch: Watch) -> None:
        super().__init__()
        self.watch = watch

    def _on_step(self) -> bool:
        return self.watch.look(self.act, self.num_timesteps)

    def act(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The actions with the highest values of the online network."""
        model = self.model
        assert isinstance(model, DQN)
        planes = torch.from_numpy(one_hot(grids))
        with torch.no_grad():
            return model.q_net({"grid": planes.float(), "telemetry": torch.from_numpy(telemetry)}).argmax(1).numpy()


def train_ours(task: str, seed: int, threads: int, watch: Watch) -> None:
    """Train with our trainer, with the defaults of `drone-env train`."""
    config = preset("fast", task)
    trainer = Trainer(dataclasses.replace(config, seed=seed, num_threads=threads, validation_every=10**9))
    for _ in trainer.train():
        if not watch.look(trainer.act, trainer.steps):
            break


def train_sb3(task: str, seed: int, threads: int, watch: Watch) -> None:
    """Train with Stable-Baselines3's DQN."""
    torch.set_num_threads(threads)
    env = DroneDeliveryVecEnv(task, NUM_ENVS, observation="dict")
    policy: dict[str, Any] = {"features_extractor_class": PathQNetFeatures, "net_arch": [], "normalize_images": False}
    model = DQN("MultiInputPolicy", env, policy_kwargs=policy, seed=seed, device="cpu", **SB3)
    model.set_logger(Logger(None, []))  # its own would leave a folder behind for each model
    model.learn(SB3_STEPS, Look(watch))


LEARNERS = {"drone-env train": train_ours, "Stable-Baselines3 DQN": train_sb3}


def main() -> None:
    """Train in turn and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="easy")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1, help="PyTorch threads (%(default)s)")
    parser.add_argument("--limit", type=float, default=900.0, help="CPU seconds of one run (%(default)s)")
    parser.add_argument("--maps", type=int, default=200, help="validation maps (%(default)s)")
    arguments = parser.parse_args()
    validator = Validator(get_task(arguments.task), arguments.maps)
    print(f"{arguments.task}, {arguments.maps} validation maps, {platform.processor()}, PyTorch {torch.__version__}")
    curves: dict[str, list[list[Point]]] = {name: [] for name in LEARNERS}
    for seed in range(arguments.seeds):
        for name, train in LEARNERS.items():
            watch = Watch(validator, arguments.limit, until=max(RATIOS))
            train(arguments.task, seed, arguments.threads, watch)
            curves[name].append(watch.curve)
            last = max(watch.curve, key=lambda point: point.ratio)
            print(f"seed {seed}, {name}: {last.ratio:.4f} after {last.seconds:.0f} s CPU", flush=True)
    print(f"\n| ratio | {' | '.join(LEARNERS)} |\n|---|{'---|' * len(LEARNERS)}")
    for ratio in RATIOS:
        cells: list[str] = []
        for runs in curves.values():
            reached = [next((point for point in curve if point.ratio >= ratio), None) for curve in runs]
            first = [point for point in reached if point is not None]
            seconds, steps = np.median([point[:2] for point in first], axis=0) if first else (math.nan, math.nan)
            cells.append(f"{seconds:.0f} s, {steps:,.0f} steps ({len(first)} of {len(runs)} runs)")
        print(f"| {ratio} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
