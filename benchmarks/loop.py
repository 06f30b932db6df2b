"""How many steps a second of CPU flies and learns: our PPO, a loop like CleanRL's, and Stable-Baselines3.

All have the same task, network (`StopEntries`, an embedding bag and two layers), number of environments, batches and
epochs, in one thread. They take turns; each turn is one rollout with its updates. The medians of the rounds count.
CleanRL's PPO is one file; this loop does what that file does, on `gymnasium.make_vec`.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import gymnasium
import torch
from gymnasium import spaces
from sb3_contrib import MaskablePPO
from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn
from torch.distributions import Categorical

from drone_env.core.tasks import get_task
from drone_env.envs.forms import StopEntries
from drone_env.envs.sb3 import DroneDeliveryVecEnv
from drone_env.envs.wrappers.vector import StopObservation
from drone_env.rl.config import PpoConfig
from drone_env.rl.model import ActorCritic
from drone_env.rl.ppo import CLOSED, PpoTrainer


class Trunk(BaseFeaturesExtractor):
    """`ActorCritic` without its heads, which Stable-Baselines3 adds."""

    def __init__(self, observation_space: spaces.Dict, entries: int, hidden: int) -> None:
        super().__init__(observation_space, hidden)
        self.network = ActorCritic(entries, observation_space["features"].shape[0], hidden)  # pyright: ignore

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """The features of a batch of observations."""
        x = self.network.stops(observations["entries"].int()) + self.network.features(observations["features"])
        return torch.relu(self.network.hidden(torch.relu(x)))


def ours(config: PpoConfig) -> Callable[[], Any]:
    """`drone-env train --algorithm ppo`."""
    trainer = PpoTrainer(config)
    return lambda: trainer.learn(trainer.fly())


def sb3(algorithm: type[PPO] | type[MaskablePPO], config: PpoConfig) -> Callable[[], Any]:
    """A learner of Stable-Baselines3 or sb3-contrib."""
    env = DroneDeliveryVecEnv(config.task, config.num_envs, observation="stops")
    trunk = {"entries": StopEntries(env.task).table_size, "hidden": config.hidden}
    policy: dict[str, Any] = {"features_extractor_class": Trunk, "features_extractor_kwargs": trunk, "net_arch": []}
    batches = {"n_steps": config.num_steps, "batch_size": config.minibatch_size, "n_epochs": config.update_epochs}
    model: Any = algorithm("MultiInputPolicy", env, policy_kwargs=policy, device="cpu", **batches)  # pyright: ignore
    model.set_logger(Logger(None, []))
    return lambda: model.learn(config.num_envs * config.num_steps, reset_num_timesteps=False)


def cleanrl(config: PpoConfig) -> Callable[[], Any]:
    """A loop like CleanRL's ppo.py."""
    n, steps, task = config.num_envs, config.num_steps, get_task(config.task)
    envs: Any = StopObservation(
        gymnasium.make_vec(task.gym_id, n, "vector_entry_point", autoreset_mode="SameStep")  # pyright: ignore
    )
    space = envs.single_observation_space
    agent = ActorCritic(StopEntries(task).table_size, space["features"].shape[0], config.hidden)
    optimizer = torch.optim.Adam(agent.parameters(), lr=config.learning_rate, eps=1e-5)
    buffers: Any = [torch.zeros(steps, n, *space[name].shape, dtype=kind) for name, kind in
                    (("entries", torch.int32), ("features", torch.float32))]  # fmt: skip
    buffers += [torch.zeros(steps, n, 5, dtype=torch.bool), torch.zeros(steps, n, dtype=torch.int64)]
    buffers += list(torch.zeros(5, steps, n))
    entries, features, masks, actions, log_probs, rewards, dones, values, advantages = buffers

    def policy(entries: Any, features: Any, masks: Any) -> Any:
        logits, value = agent(entries, features)
        return Categorical(logits=logits.masked_fill(~masks, CLOSED)), value

    def look(seen: Any, info: Any) -> list[torch.Tensor]:
        arrays = seen["entries"], seen["features"], info["action_mask"].astype(bool)
        return [torch.from_numpy(array) for array in arrays]

    seen = look(*envs.reset(seed=0))

    def one_round() -> list[tuple[float, ...]]:
        nonlocal seen
        for t in range(steps):
            entries[t], features[t], masks[t] = seen
            with torch.no_grad():
                chosen, values[t] = policy(*seen)
                actions[t] = chosen.sample()
                log_probs[t] = chosen.log_prob(actions[t])
            observations, reward, terminated, _, info = envs.step(actions[t].numpy())
            rewards[t], dones[t] = torch.from_numpy(reward), torch.from_numpy(terminated)
            seen = look(observations, info)
        with torch.no_grad():
            following, ahead = policy(*seen)[1], torch.zeros(n)
        for t in reversed(range(steps)):
            alive = config.gamma * (1 - dones[t])
            ahead = rewards[t] + alive * following - values[t] + alive * config.gae_lambda * ahead
            advantages[t], following = ahead, values[t]
        flat = [buffer.flatten(0, 1) for buffer in (entries, features, masks, actions, log_probs, advantages)]
        returns = (advantages + values).flatten()
        log: list[tuple[float, ...]] = []
        for _ in range(config.update_epochs):
            order: Any = torch.randperm(n * steps)
            for rows in order.split(config.minibatch_size):
                *known, taken, before, gain = (part[rows] for part in flat)
                chosen, value = policy(*known)
                change: Any = chosen.log_prob(taken) - before
                with torch.no_grad():  # what CleanRL logs of each update
                    far = ((change.exp() - 1).abs() > config.clip).float().mean()
                    log.append(((change.exp() - 1 - change).mean().item(), far.item()))
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                losses: Any = -gain * change.exp(), -gain * change.exp().clamp(1 - config.clip, 1 + config.clip)
                value_loss: Any = 0.5 * (value - returns[rows]).square().mean()
                bonus: Any = config.entropy_weight * chosen.entropy().mean()
                worst: Any = torch.maximum(*losses).mean()
                loss: Any = worst - bonus + config.value_weight * value_loss
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), config.max_grad_norm)
                optimizer.step()
        return log

    return one_round


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=["easy", "skyline_easy"])
    parser.add_argument("--rounds", type=int, default=9)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print("| task | learner | steps per CPU second | ours = 1 |\n|---|---|---|---|")
    for task in arguments.tasks:
        config = PpoConfig(task=task, validation_maps=1)
        makers = {"drone-env": ours, "CleanRL's loop": cleanrl, "Stable-Baselines3 PPO": partial(sb3, PPO)}
        learners = {name: make(config) for name, make in (makers | {"MaskablePPO": partial(sb3, MaskablePPO)}).items()}
        spent: dict[str, list[float]] = {name: [] for name in learners}
        for number in range(arguments.rounds + 1):
            for name, learn in learners.items():
                began = time.process_time()
                learn()
                if number:  # the first compiles
                    spent[name].append(time.process_time() - began)
        seconds = {name: statistics.median(times) for name, times in spent.items()}
        for name, took in seconds.items():
            rate = config.num_envs * config.num_steps / took
            print(f"| {task} | {name} | {rate:,.0f} | {seconds['drone-env'] / took:.2f} |", flush=True)


if __name__ == "__main__":
    main()
