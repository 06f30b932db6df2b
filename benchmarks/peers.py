"""Common first choices for Skyline: PPO of Stable-Baselines3 and MaskablePPO of sb3-contrib.

Both see the raw observation (one-hot planes through a small convolutional network, and the telemetry), are paid by
`aligned` with the shaping of their discount, learn in one thread for the same seconds of CPU time, and are validated
on 200 maps now and then, which is not counted. The policy that was best there flies the first 1,000 test maps by its
likeliest actions; MaskablePPO never takes one that would bump. A run that is finished is not repeated, one that was
stopped begins anew. The 780 seconds of a run are a third of what the tour network takes to learn all six tasks: the
three tasks together get as much as it does.

`RECIPES` are all the settings that were tried, `CHOSEN` those that are flown. `--tune` tries them and flies no test
map.

    python benchmarks/peers.py
    python benchmarks/peers.py --tune --tasks skyline_easy --cpu-seconds 60 --recipes defaults wide
"""

import argparse
import contextlib
import copy
import json
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn
from training import ReachedError, Watch
from training_runs import MAPS, ROOT, commit, figures, machine

from drone_env.agents import register_agent
from drone_env.agents.sb3_policy import Sb3Agent
from drone_env.core.rewards import DEFAULT_PROFILE, get_reward_profile, profile_for_discount
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.envs.sb3 import DroneDeliveryVecEnv
from drone_env.errors import InvalidValueError
from drone_env.files import write_json
from drone_env.rl.common import Validator

ALGORITHMS: dict[str, type[PPO] | type[MaskablePPO]] = {"PPO": PPO, "MaskablePPO": MaskablePPO}
WIDE: dict[str, Any] = {
    "num_envs": 256,
    "n_steps": 32,
    "batch_size": 1024,
    "n_epochs": 4,
    "learning_rate": 1e-3,
    "ent_coef": 0.01,
    "gamma": 0.99,
}
RECIPES: dict[str, dict[str, Any]] = {
    "defaults": {"num_envs": 8},
    "wide": WIDE,
    "patient": WIDE | {"gamma": 0.995},
    "undiscounted": WIDE | {"gamma": 1.0},
    "small_batches": WIDE | {"gamma": 1.0, "batch_size": 256, "learning_rate": 5e-4},
    "falling": WIDE | {"learning_rate": "falling"},
    "dense": WIDE | {"observation": "flat", "policy_kwargs": {"net_arch": [256, 256]}},
}
"""`num_envs` and `observation` of the environment, and arguments of PPO; the rest are Stable-Baselines3's defaults.

A learning rate that is `falling` goes from 1e-3 to 0 over the CPU seconds of the run.
"""
CHOSEN = {"PPO": "wide", "MaskablePPO": "wide"}
VALIDATION_MAPS = 200
VALIDATIONS = 30
"""In a run."""


class Cells(BaseFeaturesExtractor):
    """Two convolutions of 3 x 3 cells and a dense layer; the telemetry beside it: float32[B, 128 + telemetry_size]."""

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
        # Channels last is what convolutions are fastest on: on skyline_hard an update takes a third less time.
        planes = observations["grid"].contiguous(memory_format=torch.channels_last)
        return torch.cat([self.layers(planes), observations["telemetry"]], dim=1)


def agent_of(task: TaskConfig, model: PPO | MaskablePPO) -> Sb3Agent:
    """What flies by the likeliest actions of a model; MaskablePPO never takes one that would bump."""
    return Sb3Agent(task, model)


class Judge(BaseCallback):
    """Shows the policy to a watch after every step, and keeps the best.

    Args:
        task: The task.
        validator: Flies its validation maps.
        limit: Seconds of computing, from the first step of the training.
    """

    def __init__(self, task: TaskConfig, validator: Validator, limit: float) -> None:
        super().__init__()
        self._task, self._validator, self._limit = task, validator, limit
        self.watch: Watch | None = None
        self.weights: dict[str, Any] = {}

    def falling_rate(self, _: float) -> float:
        """The learning rate now; what it is given is the share of steps that are left, which nobody knows here."""
        spent = 0.0 if self.watch is None else self.watch.spent / self._limit
        return 1e-3 * max(0.0, 1 - spent)

    def _on_training_start(self) -> None:
        self.watch = Watch(self._validator, self._limit, shares=(), every=self._limit / VALIDATIONS)

    def _on_step(self) -> bool:
        assert self.watch is not None
        assert isinstance(self.model, (PPO, MaskablePPO))
        before = self.watch.best
        try:
            self.watch.look(agent_of(self._task, self.model).act_batch, self.num_timesteps)
        finally:
            if self.watch.best > before:
                self.weights = copy.deepcopy(self.model.policy.state_dict())
        return True


def train(
    task: TaskConfig, algorithm: str, recipe: Mapping[str, Any], seed: int, limit: float, validator: Validator
) -> tuple[Sb3Agent, Watch]:
    """Train for `limit` seconds of CPU time: the best policy by validation, and what was seen of the training."""
    options = dict(recipe)
    form = options.pop("observation", "dict")
    rewards = profile_for_discount(get_reward_profile(DEFAULT_PROFILE), options.get("gamma", 0.99))
    env = DroneDeliveryVecEnv(task, options.pop("num_envs"), reward_profile=rewards, observation=form)
    judge = Judge(task, validator, limit)
    if options.get("learning_rate") == "falling":
        options["learning_rate"] = judge.falling_rate
    if form == "dict":
        options["policy_kwargs"] = {"features_extractor_class": Cells, **options.pop("policy_kwargs", {})}
    policy = "MultiInputPolicy" if form == "dict" else "MlpPolicy"
    model = ALGORITHMS[algorithm](policy, env, seed=seed, device="cpu", **options)
    model.set_logger(Logger(None, []))  # its own would leave a folder behind for each model
    with contextlib.suppress(ReachedError):
        model.learn(10**12, judge)
    assert judge.watch is not None
    model.policy.load_state_dict(judge.weights)
    return agent_of(task, model), judge.watch


def run(
    task: TaskConfig, algorithm: str, recipe: str, seed: int, limit: float, tune: bool, folder: Path
) -> dict[str, Any]:
    """Train and fly, or read what came of it."""
    name = f"{task.id}-{algorithm}-{recipe}-{limit:g}s-seed{seed}{'-tune' if tune else ''}"
    finished = folder / f"{name}.json"
    if finished.exists():
        kept = json.loads(finished.read_text(encoding="utf-8"))
        if kept["settings"] != RECIPES[recipe]:
            raise InvalidValueError(f"{finished} was trained with other settings: move it away to train again")
        return kept
    validator = Validator(task, VALIDATION_MAPS)
    peer, watch = train(task, algorithm, RECIPES[recipe], seed, limit, validator)
    seconds, steps, _, _ = watch.curve[-1]
    register_agent(name, lambda task: peer)
    result = {
        "task": task.id,
        "task_version": task.version,
        "algorithm": algorithm,
        "recipe": recipe,
        "settings": RECIPES[recipe],
        "seed": seed,
        "cpu_seconds": seconds,
        "steps": steps,
        "commit": commit(),
        "machine": machine(),
        "packages": {name: version(name) for name in ("stable-baselines3", "sb3-contrib", "torch", "numpy")},
        "validation_maps": VALIDATION_MAPS,
        "validation_optimum": validator.optimum,
        "best_validation": max(share for _, _, share, _ in watch.curve),
        "curve": {
            column: [point[i] for point in watch.curve]
            for i, column in enumerate(("cpu_seconds", "steps", "share", "success"))
        },
        "test": None if tune else figures(task, name),
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_json(finished, result)
    return result


def row(result: dict[str, Any]) -> str:
    """A run as a row of the table."""
    test, at_best = result["test"], int(np.argmax(result["curve"]["share"]))
    judged = "- | -" if test is None else f"{test['score_ratio']:.4f} | {test['success_rate']:.1%}"
    return (
        f"| {result['task']} | {result['algorithm']} | {result['recipe']} | {result['seed']} "
        f"| {result['cpu_seconds']:.0f} | {result['steps']:,} | {result['best_validation']:.4f} "
        f"| {result['curve']['success'][at_best]:.1%} | {judged} |"
    )


HEADER = (
    "| task | learner | recipe | seed | CPU s | steps | validation: of the optimum | delivered all "
    f"| {MAPS:,} test maps: of the optimum | delivered all |\n|---|---|---|---|---|---|---|---|---|---|"
)


def main() -> None:
    """Train, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=["skyline_easy", "skyline_medium", "skyline_hard"])
    parser.add_argument("--algorithms", nargs="+", default=list(ALGORITHMS), choices=ALGORITHMS)
    parser.add_argument("--cpu-seconds", type=float, default=780, help="of each run (%(default)s)")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--recipes", nargs="+", choices=RECIPES, help="instead of the chosen ones; with --tune all")
    parser.add_argument("--tune", action="store_true", help="judge by validation maps alone")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "peers")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    results: list[dict[str, Any]] = []
    for task in map(get_task, arguments.tasks):
        for algorithm in arguments.algorithms:
            for recipe in arguments.recipes or (RECIPES if arguments.tune else [CHOSEN[algorithm]]):
                for seed in arguments.seeds:
                    limit, tune = arguments.cpu_seconds, arguments.tune
                    results.append(run(task, algorithm, recipe, seed, limit, tune, arguments.out.resolve()))
                    print(row(results[-1]), file=sys.stderr, flush=True)
    print(HEADER, *map(row, results), sep="\n")


if __name__ == "__main__":
    main()
