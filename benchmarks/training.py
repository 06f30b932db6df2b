"""How soon our trainer and Stable-Baselines3's DQN fly near the optimum.

Both learn on the same simulator with the same network, reward and validation maps, in turn, in one run. Every few
seconds of computing the network is validated, which is not counted; what is printed is when its mean score first
reached each share of the mean exact optimum. `SB3` contains the settings of Stable-Baselines3, the best of those tried
(docs/learning.md).
"""

import argparse
import contextlib
import dataclasses
import platform
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from gymnasium import spaces
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

from drone_env.agents.batch_rollout import ActBatch
from drone_env.core.tasks import get_task
from drone_env.envs.forms import one_hot
from drone_env.envs.sb3 import DroneDeliveryVecEnv
from drone_env.rl.common import Validator
from drone_env.rl.config import preset
from drone_env.rl.model import PathQNet
from drone_env.rl.trainer import Trainer

SHARES = (0.95, 0.99, 0.995)
SECONDS = 2.0
"""Of computing, between two validations."""
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
    "exploration_final_eps": 0.2,
    "max_grad_norm": 10,
}
SB3_STEPS = 400_000
SB3_EXPLORATION_STEPS = 60_000


class ReachedError(Exception):
    """Ends a run that has reached all shares, or has had its time."""


class Watch:
    """Validates now and then, and notes when the shares are reached.

    Args:
        validator: Flies the maps.
        limit: Seconds of computing after which the run is ended.
        shares: Optimality ratios; if all are reached, the run ends.
        every: Seconds of computing between two validations.
    """

    def __init__(
        self, validator: Validator, limit: float, shares: Sequence[float] = SHARES, every: float = SECONDS
    ) -> None:
        self.validator, self.limit, self.shares, self.every = validator, limit, shares, every
        self.reached: dict[float, tuple[float, float, int]] = {}
        self.curve: list[tuple[float, int, float, float]] = []
        """Seconds of computing, steps, share of the optimum and of the maps on which everything was delivered."""
        self.best = 0.0
        self._cpu, self._wall = time.process_time(), time.perf_counter()
        self._next = every

    @property
    def spent(self) -> float:
        """Seconds of computing so far, less those of validation."""
        return time.process_time() - self._cpu

    def look(self, act: ActBatch, steps: int) -> None:
        """Validate if it is time to; `steps` have been flown.

        Raises:
            ReachedError: when there is nothing more to wait for.
        """
        cpu, wall = time.process_time(), time.perf_counter()
        if cpu - self._cpu < self._next:
            return
        spent = cpu - self._cpu
        validation = self.validator.validate(act)
        share = validation.score / validation.optimum
        self.curve.append((spent, steps, share, validation.success))
        self.best = max(self.best, share)
        for wanted in self.shares:
            if share >= wanted and wanted not in self.reached:
                self.reached[wanted] = spent, wall - self._wall, steps
        if (self.shares and len(self.reached) == len(self.shares)) or spent >= self.limit:
            raise ReachedError
        self._cpu += time.process_time() - cpu
        self._wall += time.perf_counter() - wall
        self._next = min(spent + self.every, self.limit)


class PathQNetFeatures(BaseFeaturesExtractor):
    """PathQNet up to its last layer, which is the one that Stable-Baselines3 adds."""

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
        self.watch.look(self.act, self.num_timesteps)
        return True

    def act(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The actions of the highest values of the network that acts."""
        model = self.model
        assert isinstance(model, DQN)
        planes = torch.from_numpy(one_hot(grids))
        with torch.no_grad():
            return model.q_net({"grid": planes.float(), "telemetry": torch.from_numpy(telemetry)}).argmax(1).numpy()


def ours(task: str, seed: int, threads: int, validator: Validator, limit: float) -> Watch:
    """Train with our trainer, by the defaults of `drone-env train`."""
    config = dataclasses.replace(
        preset("fast", task), seed=seed, num_threads=threads, validation_every=10**9, validation_maps=1
    )
    trainer = Trainer(config)
    watch = Watch(validator, limit)
    with contextlib.suppress(ReachedError):
        for _ in trainer.train():
            watch.look(trainer.act, trainer.steps)
    return watch


def theirs(task: str, seed: int, threads: int, validator: Validator, limit: float) -> Watch:
    """Train with Stable-Baselines3's DQN."""
    torch.set_num_threads(threads)
    env = DroneDeliveryVecEnv(task, NUM_ENVS, observation="dict")
    policy: dict[str, Any] = {"features_extractor_class": PathQNetFeatures, "net_arch": [], "normalize_images": False}
    exploration = SB3_EXPLORATION_STEPS / SB3_STEPS
    model = DQN(
        "MultiInputPolicy", env, policy_kwargs=policy, exploration_fraction=exploration, seed=seed, device="cpu", **SB3
    )
    model.set_logger(Logger(None, []))  # its own would leave a folder behind for each model
    watch = Watch(validator, limit)
    with contextlib.suppress(ReachedError):
        model.learn(SB3_STEPS, Look(watch))
    return watch


CONTENDERS: dict[str, Callable[[str, int, int, Validator, float], Watch]] = {
    "drone-env train": ours,
    "Stable-Baselines3 DQN": theirs,
}


def shown(times: list[tuple[float, float, int] | None], of: int) -> str:
    """The median of what was reached, or that not all runs got there."""
    if any(entry is None for entry in times):
        return f"{sum(entry is not None for entry in times)} of {of} runs"
    cpu, wall, steps = np.median(np.array(times, float), axis=0)
    return f"{cpu:.0f} s CPU, {wall:.0f} s, {steps:,.0f} steps"


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="easy")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1, help="that PyTorch computes with")
    parser.add_argument("--limit", type=float, default=900.0, help="seconds of computing for one run")
    parser.add_argument("--maps", type=int, default=200, help="validation maps")
    arguments = parser.parse_args()
    task = get_task(arguments.task)
    validator = Validator(task, arguments.maps)
    print(f"{task.id}, {arguments.maps} validation maps, {arguments.threads} threads, {platform.processor()}")
    print(
        f"PyTorch {torch.__version__}; Stable-Baselines3: {SB3}, {NUM_ENVS} episodes side by side, epsilon to its end "
    )
    print(f"in {SB3_EXPLORATION_STEPS:,} steps")
    watches: dict[str, list[Watch]] = {name: [] for name in CONTENDERS}
    for seed in range(arguments.seeds):
        for name, run in CONTENDERS.items():
            watch = run(task.short_name, seed, arguments.threads, validator, arguments.limit)
            watches[name].append(watch)
            reached = {share: f"{cpu:.0f} s CPU" for share, (cpu, _, _) in watch.reached.items()}
            print(f"seed {seed}, {name}: {reached}, best {watch.best:.4f} of the optimum", flush=True)
    print(
        f"\n| of the optimum | {' | '.join(CONTENDERS)} | ratio of CPU seconds |\n|---|"
        + "---|" * (len(CONTENDERS) + 1)
    )
    for share in SHARES:
        times = {name: [watch.reached.get(share) for watch in of] for name, of in watches.items()}
        medians = [np.median([entry[0] for entry in of if entry]) if all(of) else None for of in times.values()]
        ratio = f"{medians[1] / medians[0]:.1f}" if medians[0] and medians[1] else "-"
        print(f"| {share} | {' | '.join(shown(of, arguments.seeds) for of in times.values())} | {ratio} |")


if __name__ == "__main__":
    main()
