"""Common first choices for Skyline: PPO of Stable-Baselines3 and MaskablePPO of sb3-contrib.

Both see the raw observation (one-hot planes through a small convolutional network, and the telemetry) and learn from
`aligned` with the shaping of their discount, in one thread, for the same CPU time. Validations do not count. The policy
with the best validation flies the first 1,000 test maps by its likeliest actions; MaskablePPO never bumps. The three
tasks together get as much CPU time as the tour network for all six. `RECIPE` was the best of seven. A finished run is
not repeated.
"""

import argparse
import copy
import json
from pathlib import Path
from typing import Any

import torch
from gymnasium import spaces
from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn
from training import Watch
from training_runs import MAPS, ROOT, fly_test_maps

from drone_env.agents import register_agent
from drone_env.agents.custom import Sb3Agent
from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile, profile_for_discount
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.envs.sb3 import DroneDeliveryVecEnv
from drone_env.files import write_json
from drone_env.rl.common import Validator

ALGORITHMS: dict[str, type[PPO] | type[MaskablePPO]] = {"PPO": PPO, "MaskablePPO": MaskablePPO}
NUM_ENVS = 256
RECIPE: dict[str, Any] = {
    "n_steps": 32,
    "batch_size": 1024,
    "n_epochs": 4,
    "learning_rate": 1e-3,
    "ent_coef": 0.01,
    "gamma": 0.99,
}
VALIDATION_MAPS = 200
VALIDATIONS = 30
"""Number of validations in a run."""


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


class KeepBest(BaseCallback):
    """Shows the policy to a watch after every step, and keeps the weights with the best validation."""

    def __init__(self, task: TaskConfig, watch: Watch) -> None:
        super().__init__()
        self._task, self._watch = task, watch
        self.weights: dict[str, Any] = {}

    def _on_step(self) -> bool:
        before = len(self._watch.curve)
        continues = self._watch.look(Sb3Agent(self._task, self.model).act_batch, self.num_timesteps)
        ratios = [point.ratio for point in self._watch.curve]
        if len(ratios) > before and ratios[-1] == max(ratios):
            self.weights = copy.deepcopy(self.model.policy.state_dict())
        return continues


def train(task: TaskConfig, algorithm: str, seed: int, seconds: float) -> tuple[Sb3Agent, Watch]:
    """Train for some CPU seconds; return the best policy by validation, and its watch."""
    validator = Validator(task, VALIDATION_MAPS)
    rewards = profile_for_discount(get_reward_profile(DEFAULT_PROFILE), RECIPE["gamma"])
    env = DroneDeliveryVecEnv(task, NUM_ENVS, reward_profile=rewards, observation="dict")
    network = {"features_extractor_class": Cells}
    model = ALGORITHMS[algorithm]("MultiInputPolicy", env, seed=seed, device="cpu", policy_kwargs=network, **RECIPE)
    model.set_logger(Logger(None, []))  # its own would leave a folder behind for each model
    best = KeepBest(task, watch := Watch(validator, seconds, every=seconds / VALIDATIONS))
    model.learn(10**12, best)
    model.policy.load_state_dict(best.weights)
    return Sb3Agent(task, model), watch


def run(task: TaskConfig, algorithm: str, seed: int, seconds: float, folder: Path) -> dict[str, Any]:
    """Train and fly, or read the result of an earlier run."""
    name = f"{task.id}-{algorithm}-{seconds:g}s-seed{seed}"
    finished = folder / f"{name}.json"
    if finished.exists():
        return json.loads(finished.read_text(encoding="utf-8"))
    agent, watch = train(task, algorithm, seed, seconds)
    register_agent(name, lambda task: agent)
    columns = ("cpu_seconds", "steps", "ratio", "success")
    result = {
        "task": task.id,
        "algorithm": algorithm,
        "settings": RECIPE,
        "seed": seed,
        "curve": dict(zip(columns, zip(*watch.curve, strict=True), strict=True)),
        "test": fly_test_maps(task, name),
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_json(finished, result)
    return result


def main() -> None:
    """Train, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=["skyline_easy", "skyline_medium", "skyline_hard"])
    parser.add_argument("--algorithms", nargs="+", default=list(ALGORITHMS), choices=ALGORITHMS)
    parser.add_argument("--cpu-seconds", type=float, default=780, help="of each run (%(default)s)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "peers")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print(f"| task | learner | seed | steps | validation ratio | {MAPS:,} test maps: ratio | delivered all |")
    print("|---|---|---|---|---|---|---|")
    for task in map(get_task, arguments.tasks):
        for algorithm in arguments.algorithms:
            for seed in arguments.seeds:
                result = run(task, algorithm, seed, arguments.cpu_seconds, arguments.out.resolve())
                curve, test = result["curve"], result["test"]
                print(
                    f"| {task.id} | {algorithm} | {seed} | {curve['steps'][-1]:,} | {max(curve['ratio']):.4f} "
                    f"| {test['score_ratio']:.4f} | {test['success_rate']:.1%} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
