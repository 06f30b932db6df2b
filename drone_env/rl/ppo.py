"""Proximal policy optimisation from the batched simulator.

Schulman et al., "Proximal policy optimization algorithms", 2017; Schulman et al., "High-dimensional continuous control
using generalized advantage estimation", ICLR 2016. N environments step together; after `num_steps` steps the network
learns from them for `update_epochs` epochs. Actions that would bump are masked (Huang and Ontañón,
"A closer look at invalid action masking in policy gradient algorithms", FLAIRS 2022), with `shield` also those that
may strand the drone (Alshiekh et al., "Safe reinforcement learning via shielding", AAAI 2018). The exported network is
the moving average of the weights (Polyak and Juditsky, 1992).

Every end is part of the task: nothing bootstraps over an end, and nothing truncates an episode.
"""

import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from drone_env.agents.weights_file import PPO
from drone_env.core.seeds import SPLITS
from drone_env.envs.forms import DIRECTION_FEATURES, StopEntries
from drone_env.planning.nearby import choices
from drone_env.rl.common import TaskTrainer, figure, update_average
from drone_env.rl.config import PpoConfig
from drone_env.rl.model import ActorCritic

CLOSED = -1e8
"""The logit of a masked action."""


@dataclass(frozen=True)
class PpoProgress:
    """One line of a training's log.

    Attributes:
        steps: Environment steps so far.
        updates: Updates of the network so far.
        learning_rate: The current one.
        entropy: Mean entropy of the choices since the previous line.
        loss: Mean loss of the updates since the previous line.
        score: Mean graded score of the training episodes, with sampled actions, that ended since the previous line;
            NaN if none ended.
        validation: Mean score of the averaged network on the validation maps, with its likeliest actions, at the last
            validation; NaN before it.
        validation_sampled: The same with sampled actions.
        validation_optimum: Exact optimum of the same maps; NaN if it is unknown.
        cpu_seconds: Processor time of this training, validations included.
    """

    steps: int
    updates: int
    learning_rate: float
    entropy: float
    loss: float
    score: float
    validation: float
    validation_sampled: float
    validation_optimum: float
    cpu_seconds: float

    @property
    def summary(self) -> str:
        """The line, abridged for the progress bar."""
        validation = f"validation {figure(self.validation, 4)} of {figure(self.validation_optimum, 4)}"
        return f"{validation}  sampled {figure(self.validation_sampled, 4)}  entropy {figure(self.entropy, 3)}"


class PpoTrainer(TaskTrainer):
    """One PPO training, from its first step or from a checkpoint.

    Args:
        config: The settings.
    """

    modules = ("online", "average", "optimizer")
    variables = ("steps", "updates", "scores", "losses", "best_score", "sampled", "cpu_seconds")
    progress = PpoProgress
    config: PpoConfig

    def __init__(self, config: PpoConfig) -> None:
        super().__init__(config)
        self.rng = torch.Generator().manual_seed(config.seed)
        train = SPLITS["train"]
        self.batch.reset(torch.randint(train.start, train.stop, (config.num_envs,), generator=self.rng).numpy())
        self.look = StopEntries(self.task, config.rush)
        self.online = ActorCritic(self.look.table_size, self.task.telemetry_size + DIRECTION_FEATURES, config.hidden)
        self.average = deepcopy(self.online)
        self.optimizer = torch.optim.Adam(self.online.parameters(), lr=config.learning_rate, eps=1e-5)
        self.sampled = math.nan
        """The score with sampled actions at the last validation."""
        self.scores: list[float] = []
        """Of the episodes that ended since the last line of the log."""
        self.losses: list[tuple[float, float]] = []
        """Loss and entropy of the updates since then."""
        self.cpu_seconds = 0.0

    def train(self) -> Iterator[list[PpoProgress]]:
        """Train until `config.steps` environment steps; yields the new log lines after each round of updates.

        The caller may save the state between two rounds, or stop.
        """
        while self.steps < self.config.steps:
            self.learn(self.fly())
            self.steps += self.config.num_steps * self.config.num_envs
            yield self.log()

    @torch.no_grad()
    def fly(self) -> list[Tensor]:
        """Fly `num_steps` steps in every environment with sampled actions.

        Returns:
            Entries, features, masks, actions, their log-probabilities, advantages and returns of all steps.
        """
        config, batch = self.config, self.batch
        rows: list[tuple[Tensor, ...]] = []
        values, rewards, alive = list[Tensor](), list[Tensor](), list[Tensor]()
        for _ in range(config.num_steps):
            seen = self.observe(batch.grids, batch.telemetry)
            log_probs, value = self.policy(self.online, *seen)
            actions = sample(log_probs, self.rng)
            batch.step(actions.numpy())
            rows.append((*seen, actions, log_probs.gather(1, actions[:, None])[:, 0]))
            values.append(value)
            rewards.append(torch.from_numpy(batch.rewards * config.reward_scale).float())
            alive.append(torch.from_numpy(~batch.terminated).float())
            self.scores.extend(batch.finals()["score"].tolist())
        seen = self.observe(batch.grids, batch.telemetry)
        values.append(self.policy(self.online, *seen)[1])
        advantage, advantages = torch.zeros(config.num_envs), list[Tensor]()
        for t in reversed(range(config.num_steps)):
            discount = config.gamma * alive[t]
            advantage = rewards[t] + discount * (values[t + 1] + config.gae_lambda * advantage) - values[t]
            advantages.insert(0, advantage)
        gained = torch.cat(advantages)
        return [*map(torch.cat, zip(*rows, strict=True)), gained, gained + torch.cat(values[:-1])]

    def learn(self, flown: list[Tensor]) -> None:
        """Fit the network to these steps, in `update_epochs` epochs of minibatches."""
        config = self.config
        entropy_weight = config.entropy_weight * self.left
        for _ in range(config.update_epochs):
            order = torch.randperm(len(flown[0]), generator=self.rng)
            for start in range(0, len(order), config.minibatch_size):
                chosen = order[start : start + config.minibatch_size]
                *seen, actions, old_log_probs, advantages, returns = (part[chosen] for part in flown)
                log_probs, values = self.policy(self.online, *seen)
                ratio = (log_probs.gather(1, actions[:, None])[:, 0] - old_log_probs).exp()
                clipped = ratio.clamp(1 - config.clip, 1 + config.clip)
                gain = (advantages - advantages.mean()) / (advantages.std(correction=0) + 1e-8)
                entropy = -(log_probs.exp() * log_probs).sum(1).mean()
                value_loss = (values - returns).square().mean() / 2
                loss = -torch.min(gain * ratio, gain * clipped).mean() + config.value_weight * value_loss
                loss = loss - entropy_weight * entropy
                self.fit(loss, self.learning_rate)
                # The average covers fewer updates at first, to forget the initial weights.
                update_average(self.average, self.online, 1 - min(config.average, 1 - 1 / (self.updates / 10 + 1)))
                self.losses.append((loss.item(), entropy.item()))

    def observe(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> tuple[Tensor, ...]:
        """The inputs of the network, entries and features, and the masks of its actions."""
        seen = self.look({"grid": grids, "telemetry": telemetry})
        masks = choices(seen["entries"], telemetry[:, 2] == 1, self.config.shield, self.config.rush)
        arrays = seen["entries"], seen["features"], masks
        return tuple(torch.from_numpy(array) for array in arrays)

    @staticmethod
    def policy(network: ActorCritic, entries: Tensor, features: Tensor, masks: Tensor) -> tuple[Tensor, Tensor]:
        """Log-probabilities of the actions, float32[B, 5], and values of the states, float32[B]."""
        logits, values = network(entries, features)
        return logits.masked_fill(~masks, CLOSED).log_softmax(1), values

    @torch.no_grad()
    def act(
        self,
        grids: npt.NDArray[np.uint8],
        telemetry: npt.NDArray[np.float32],
        network: ActorCritic | None = None,
        rng: torch.Generator | None = None,
    ) -> npt.NDArray[np.int64]:
        """The actions of a network, or else the averaged one, int64[N]: the likeliest, or samples."""
        seen = self.observe(grids, telemetry)
        log_probs, _ = self.policy(network or self.average, *seen)
        return (log_probs.argmax(1) if rng is None else sample(log_probs, rng)).numpy()

    def validate(self) -> None:
        """Fly the validation maps with the averaged network, and keep it if it is the best so far."""
        network = deepcopy(self.average).half().float()  # as a file holds it
        self.keep_best(network, partial(self.act, network=network))
        sampling = torch.Generator().manual_seed(self.config.seed)  # of its own: validations do not change the training
        self.sampled = self.validator.validate(partial(self.act, network=network, rng=sampling)).score

    def log(self) -> list[PpoProgress]:
        """Validate and log if it is due; the new line of the log, if there is one."""
        config, last = self.config, self.steps >= self.config.steps
        before = self.steps - config.num_envs * config.num_steps

        def due(every: int) -> bool:
            return last or self.steps // every > before // every

        if due(config.validation_every):
            self.validate()
        if not due(config.log_every):
            return []
        loss, entropy = np.mean(self.losses, axis=0).tolist()
        line = PpoProgress(
            steps=self.steps,
            updates=self.updates,
            learning_rate=self.learning_rate,
            entropy=entropy,
            loss=loss,
            score=float(np.mean(self.scores)) if self.scores else math.nan,
            validation=self.validation.score,
            validation_sampled=self.sampled,
            validation_optimum=self.validation.optimum,
            cpu_seconds=self.cpu_seconds,
        )
        self.scores, self.losses = [], []
        self.history.append(line)
        return [line]

    @property
    def left(self) -> float:
        """The share of the training that is left."""
        return max(1 - self.steps / self.config.steps, 0.0)

    @property
    def learning_rate(self) -> float:
        """The current learning rate: it falls to 0 in a straight line."""
        return self.config.learning_rate * self.left

    def get_state(self) -> dict[str, Any]:
        """The state of the training as tensors and plain values."""
        return super().get_state() | {"rng": self.rng.get_state()}

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from a state of `get_state`."""
        super().set_state(state)
        self.rng.set_state(state["rng"])

    def metadata(self) -> dict[str, Any]:
        """The metadata of the exported network."""
        return super().metadata() | {"network": PPO}


def sample(log_probs: Tensor, rng: torch.Generator) -> Tensor:
    """Sampled actions, int64[N] (Gumbel-max)."""
    return (log_probs - torch.empty_like(log_probs).exponential_(generator=rng).log_()).argmax(1)
