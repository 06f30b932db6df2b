"""Offline learning: behaviour cloning and implicit Q-learning from flights of a weak and a good agent.

    pip install -e '.[data,train]'
    drone-env dataset --minari --task skyline_easy --maps 1000 --agents greedy optimal --epsilon 0.2 --out flights
    MINARI_DATASETS_PATH=flights/minari python examples/offline.py

A normalised score is 0 for the random agent and 1 for the optimum (`minari.get_normalized_score`).

Nothing flies while it learns, and nothing reads the exact values that the dataset contains beside each step. The clone
imitates both agents, so where they differ it follows the weak one as often as the good one. The critic learns what the
better actions in the data are worth: Kostrikov, Nair and Levine, "Offline reinforcement learning with implicit
Q-learning", ICLR 2022. The learned policy is the clone, with the probability of each action times exp(Q / temperature).
The paper fits a third network to it; with five actions, it can be computed.
"""

from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import minari
import numpy as np
import torch
import tyro
from torch import Tensor

from drone_env import evaluate, get_task, summarise
from drone_env.agents.base import StatelessAgent
from drone_env.envs.forms import StopEntries
from drone_env.planning.nearby import action_masks
from drone_env.rl.model import ActorCritic


@dataclass
class Args:
    """The hyperparameters."""

    dataset: str = "drone_delivery_skyline_easy-v2"
    """id of the Minari dataset"""
    seeds: tuple[int, ...] = (0, 1, 2)
    """seeds of the trainings"""
    updates: int = 800
    """updates of the networks"""
    batch_size: int = 1024
    """transitions per update"""
    hidden: int = 128
    """width of the networks"""
    learning_rate: float = 1e-3
    """the learning rate at the start; it falls to 0"""
    gamma: float = 0.99
    """discount factor; the shaping of the profile `aligned` uses the same"""
    expectile: float = 0.7
    """which actions in the data the critic values: 0.5 is their mean, 1 the best"""
    temperature: float = 0.1
    """the advantage that makes an action e times as likely as in the data"""
    tau: float = 0.05
    """weight of the online critic in a soft target update"""
    maps: int = 1000
    """number of test maps"""


class Learned(StatelessAgent):
    """The clone, alone or with a critic, as an agent of the package: the likeliest action that does not bump."""

    def __init__(self, clone: ActorCritic, critic: ActorCritic | None = None) -> None:
        self.clone, self.critic = clone, critic

    @torch.no_grad()
    def act_batch(self, grids, telemetry):
        """The next actions of N drones."""
        seen = look({"grid": grids, "telemetry": telemetry})
        entries, features = torch.as_tensor(seen["entries"]), torch.as_tensor(seen["features"])
        log_probs = self.clone(entries, features)[0].log_softmax(1)
        if self.critic is not None:
            log_probs += self.critic(entries, features)[0] / args.temperature
        return np.where(action_masks(seen["entries"]), log_probs.numpy(), -np.inf).argmax(axis=1)


def load(dataset: minari.MinariDataset) -> list[Tensor]:
    """All transitions: entries, features, actions, rewards, ends, and the entries and features after each."""
    columns: list[tuple[Any, ...]] = []
    for episode in dataset.iterate_episodes():
        seen = look(episode.observations)
        before, after = ([seen[name][rows] for name in seen] for rows in (slice(-1), slice(1, None)))
        columns.append((*before, episode.actions, episode.rewards.astype(np.float32), episode.terminations, *after))
    return [torch.as_tensor(np.concatenate(column)) for column in zip(*columns, strict=True)]


def chosen(outputs: Tensor, actions: Tensor) -> Tensor:
    """The output of each action taken, float32[B]."""
    return outputs.gather(1, actions[:, None])[:, 0]


def learn(transitions: list[Tensor], seed: int) -> tuple[ActorCritic, ActorCritic]:
    """Return a clone and a critic, whose outputs are Q(s, a) of the five actions and V(s)."""
    torch.manual_seed(seed)
    clone, critic = (ActorCritic(look.table_size, transitions[1].shape[1], args.hidden) for _ in range(2))
    target = deepcopy(critic)
    optimizer = torch.optim.Adam([*clone.parameters(), *critic.parameters()], lr=args.learning_rate)
    scheduler = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, args.updates)
    for _ in range(args.updates):
        rows = torch.randint(len(transitions[0]), (args.batch_size,))
        entries, features, actions, rewards, ends, next_entries, next_features = (part[rows] for part in transitions)
        cloning = -chosen(clone(entries, features)[0].log_softmax(1), actions)
        q_values, values = critic(entries, features)
        with torch.no_grad():
            returns = rewards + args.gamma * ~ends * critic(next_entries, next_features)[1]
            targets = chosen(target(entries, features)[0], actions)
        errors = targets - values
        weights = torch.where(errors > 0, args.expectile, 1 - args.expectile)
        loss = cloning + weights * errors.square() + (chosen(q_values, actions) - returns).square()
        optimizer.zero_grad()
        loss.mean().backward()
        optimizer.step()
        scheduler.step()
        with torch.no_grad():
            for slow, fast in zip(target.parameters(), critic.parameters(), strict=True):
                slow.lerp_(fast, args.tau)
    return clone, critic


args = tyro.cli(Args, description=__doc__)
torch.set_num_threads(1)
data = minari.load_dataset(args.dataset)
task = get_task(data.env_spec.kwargs["task"])
look = StopEntries(task)
transitions = load(data)
for seed in args.seeds:
    clone, critic = learn(transitions, seed)
    for name, agent in {"cloning": Learned(clone), "implicit Q-learning": Learned(clone, critic)}.items():
        figures = summarise(evaluate(agent, task, "test", args.maps))
        score, optimum = figures["mean_score"], figures["mean_optimal_score"]
        normalised = minari.get_normalized_score(data, np.array(score))
        print(f"{name}, seed {seed}: score {score:.4f}, optimum {optimum:.4f}, normalised {normalised:.4f}", flush=True)
