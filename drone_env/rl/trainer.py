"""Deep Q-learning from the batched simulator.

Mnih et al., "Human-level control through deep reinforcement learning", Nature 2015; van Hasselt, Guez, Silver, "Deep
reinforcement learning with double Q-learning", AAAI 2016; Bellemare et al., "Increasing the action gap: new operators
for reinforcement learning", AAAI 2016 (advantage learning). N environments step together; each step adds N transitions
to the replay buffer, and the network gets one update every `steps_per_update` environment steps.

Every end is part of the task: targets never bootstrap over an end, and nothing truncates an episode.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import smooth_l1_loss

from drone_env.core.seeds import SPLITS
from drone_env.errors import InvalidValueError
from drone_env.rl.common import TaskTrainer, figure, update_average
from drone_env.rl.config import TrainConfig
from drone_env.rl.model import PathQNet
from drone_env.rl.policy import epsilon_greedy, linear, multiplicative

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Progress:
    """One line of a training's log.

    Short episodes finish first, so the means cover episodes in the order of their starts, up to the first that still
    flies: all that no earlier line covers, and at least the last `log_every`. NaN if there are none.

    Attributes:
        episode: Episodes ended so far.
        steps: Environment steps.
        updates: Updates of the network.
        epsilon: Probability of a random action.
        loss: Mean loss of the updates since the previous line, else the previous line's; NaN before the first update.
        reward: Mean undiscounted return.
        score: Mean graded score.
        success: Share of episodes with all parcels delivered.
        length: Mean steps of an episode.
        validation: Mean score of the network on the validation maps, at the last validation; NaN before it.
        validation_optimum: Exact optimum of the same maps; NaN if it is unknown.
        cpu_seconds: Processor time of this training, validations included.
    """

    episode: int
    steps: int
    updates: int
    epsilon: float
    loss: float
    reward: float
    score: float
    success: float
    length: float
    validation: float
    validation_optimum: float
    cpu_seconds: float

    @property
    def summary(self) -> str:
        """The line, abridged for the progress bar."""
        validation = f"validation {figure(self.validation, 4)} of {figure(self.validation_optimum, 4)}"
        return f"{validation}  loss {figure(self.loss, 4)}  epsilon {self.epsilon:.2f}"


class ReplayBuffer:
    """The last steps of N environments, one row of N for each step.

    Each observation is stored once: the next one is in the next row. After an end, the next row holds the first
    observation of another episode, which no target uses.

    Args:
        capacity: Transitions to hold, rounded down to whole rows; at least two of them.
        num_envs: N.
        height: Rows of the grid.
        width: Columns of the grid.
        telemetry_size: Values in the telemetry.
    """

    def __init__(self, capacity: int, num_envs: int, height: int, width: int, telemetry_size: int) -> None:
        rows = capacity // num_envs
        self.grids = np.zeros((rows, num_envs, height, width), np.uint8)
        self.telemetry = np.zeros((rows, num_envs, telemetry_size), np.float32)
        self.actions = np.zeros((rows, num_envs), np.uint8)
        self.rewards = np.zeros((rows, num_envs), np.float32)
        self.terminated = np.zeros((rows, num_envs), np.bool_)
        self.added = 0
        """Rows written so far."""

    @property
    def stored(self) -> int:
        """Rows in the buffer."""
        return min(self.added, len(self.grids))

    @property
    def _columns(self) -> dict[str, Array]:
        return {name: column for name, column in vars(self).items() if name != "added"}

    def add(self, grids: Array, telemetry: Array, actions: Array, rewards: Array, terminated: Array) -> None:
        """Store one step of all environments; it replaces the oldest."""
        row, step = self.added % len(self.grids), (grids, telemetry, actions, rewards, terminated)
        for column, values in zip(self._columns.values(), step, strict=True):
            column[row] = values
        self.added += 1

    def sample(self, batch_size: int, gamma: float, rng: np.random.Generator) -> tuple[Array, ...]:
        """Uniformly sampled transitions; the buffer holds at least two rows.

        Returns:
            Grids uint8[B, H, W], telemetry float32[B, telemetry_size], actions int64[B], rewards float32[B], discounts
            of the next state's value (gamma, or 0 if the episode ended) float32[B], next grids, next telemetry.
        """
        rows = len(self.grids)
        first = self.added - self.stored + rng.integers(0, self.stored - 1, batch_size)
        env = rng.integers(0, self.grids.shape[1], batch_size)
        now, later = (first % rows, env), ((first + 1) % rows, env)
        discounts = np.float32(gamma) * ~self.terminated[now]
        reached = self.actions[now].astype(np.int64), self.rewards[now], discounts
        return self.grids[now], self.telemetry[now], *reached, self.grids[later], self.telemetry[later]

    def get_state(self) -> dict[str, Array]:
        """The rows in the buffer, and how many were written."""
        return {name: column[: self.stored] for name, column in self._columns.items()} | {"added": np.array(self.added)}

    def set_state(self, state: dict[str, Array]) -> None:
        """Take the rows of another buffer of the same size."""
        self.added = int(state["added"])
        for name, column in self._columns.items():
            column[: self.stored] = state[name]


class Trainer(TaskTrainer):
    """One DQN training, from its first step or from a checkpoint.

    Args:
        config: The settings.

    Raises:
        InvalidValueError: if the settings name a GPU and there is none.
    """

    modules = ("online", "target", "optimizer")
    variables = ("steps", "updates", "episodes", "updates_due", "validated_updates", "best_score", "early", "window",
                 "losses", "cpu_seconds")  # fmt: skip
    progress = Progress
    config: TrainConfig

    def __init__(self, config: TrainConfig) -> None:
        if config.gpu and not torch.cuda.is_available():
            raise InvalidValueError("--gpu needs a CUDA device, and PyTorch sees none; train without it on the CPU")
        super().__init__(config)
        task = self.task
        self.device = torch.device("cuda" if config.gpu else "cpu")
        self.rng = np.random.default_rng(config.seed)
        self.batch.reset(self.rng.integers(SPLITS["train"].start, SPLITS["train"].stop, config.num_envs))
        self.online = PathQNet(task.telemetry_size).to(self.device)
        self.target = PathQNet(task.telemetry_size).to(self.device)
        self.target.load_state_dict(self.online.state_dict())
        self.optimizer = torch.optim.Adam(self.online.parameters(), lr=config.learning_rate)
        self.replay = ReplayBuffer(config.replay_size, config.num_envs, task.height, task.width, task.telemetry_size)
        self.episodes = 0
        self.updates_due = 0.0
        self.validated_updates = -1
        self.returns = np.zeros(config.num_envs)
        """Of the running episodes, undiscounted."""
        self.numbers = np.arange(config.num_envs)
        """Numbers of the running episodes, in the order of their starts."""
        self.early: dict[int, tuple[float, float, bool, int]] = {}
        """Of episodes that no line of the log covers yet, by number: undiscounted return, score, whether all parcels
        were delivered, steps."""
        self.window: list[tuple[float, float, bool, int]] = []
        """The same of the episodes that the last line covers."""
        self.losses: list[float] = []
        self.cpu_seconds = 0.0

    def train(self) -> Iterator[list[Progress]]:
        """Train until `config.episodes` episodes or more have ended; yields the new log lines after each step.

        The caller may save the state between two steps, or stop.
        """
        config = self.config
        while self.episodes < config.episodes:
            self.fly()
            if self.steps > config.learning_starts and self.replay.stored > 1:
                self.updates_due += config.num_envs / config.steps_per_update
            while self.updates_due >= 1:
                self.learn()
                self.updates_due -= 1
            yield self.count_episodes()

    def fly(self) -> None:
        """Fly one step in every environment and store it."""
        batch = self.batch
        obs = batch.grids.copy(), batch.telemetry.copy()
        actions = epsilon_greedy(self.q_values(*obs, self.online), self.epsilon, self.rng)
        batch.step(actions)
        self.replay.add(*obs, actions, batch.rewards * self.config.reward_scale, batch.terminated)
        self.returns += batch.rewards
        self.steps += self.config.num_envs

    def learn(self) -> None:
        """Fit the online network to one batch of the replay buffer."""
        config = self.config
        sample = self.replay.sample(config.batch_size, config.gamma, self.rng)
        grids, telemetry, actions, rewards, discounts, next_grids, next_telemetry = map(self.tensor, sample)
        actions = actions.unsqueeze(1)
        with torch.no_grad():
            next_q = self.target(next_grids, next_telemetry)
            selector = self.online(next_grids, next_telemetry) if config.double else next_q
            td_target = rewards + discounts * next_q.gather(1, selector.argmax(1, keepdim=True)).squeeze(1)
            if config.advantage_learning:
                q = self.target(grids, telemetry)
                td_target += config.advantage_learning * (q.gather(1, actions).squeeze(1) - q.amax(1))

        q_values = self.online(grids, telemetry).gather(1, actions).squeeze(1)
        loss = smooth_l1_loss(q_values, td_target)
        self.fit(loss, self.learning_rate)
        self.losses.append(float(loss.item()))
        if config.target_update == "soft":
            update_average(self.target, self.online, config.tau)

    def count_episodes(self) -> list[Progress]:
        """Count the episodes that the last step ended; copy the target, validate and log when due."""
        config, before, finals = self.config, self.episodes, self.batch.finals()
        columns = (self.batch.ended, finals["score"], finals["steps"], finals["deliveries"])
        for i, score, steps, deliveries in zip(*(column.tolist() for column in columns), strict=True):
            success = deliveries == self.task.deliveries
            self.early[int(self.numbers[i])] = (float(self.returns[i]), score, success, steps)
            self.numbers[i] = self.episodes + config.num_envs
            self.returns[i] = 0.0
            self.episodes += 1

        def due(every: int) -> bool:
            return self.episodes // every > before // every

        last = self.episodes >= config.episodes
        if config.target_update == "episodes" and due(config.target_every):
            self.target.load_state_dict(self.online.state_dict())
        if (last or due(config.validation_every)) and self.updates != self.validated_updates:
            self.validate()
        return [self.log()] if last or due(config.log_every) else []

    def validate(self) -> None:
        """Fly the validation maps with the network alone, and keep it if it is the best so far."""
        self.keep_best(self.eval_network, self.act)
        self.validated_updates = self.updates

    @property
    def eval_network(self) -> PathQNet:
        """The network that is validated and exported.

        A soft target is a moving average of the online network and flies far better: on hard, after 2,000 updates,
        0.990 of the optimum against 0.905 (Polyak and Juditsky, "Acceleration of stochastic approximation by
        averaging", 1992). A periodic target is only older.
        """
        return self.target if self.config.target_update == "soft" else self.online

    def log(self) -> Progress:
        """Append the next line to the log."""
        oldest = self.numbers.min()
        finished = [self.early.pop(number) for number in sorted(self.early) if number < oldest]
        self.window = [*self.window, *finished][-max(len(finished), self.config.log_every) :]
        reward, score, success, length = np.mean(self.window, axis=0).tolist() if self.window else [math.nan] * 4
        before = self.history[-1].loss if self.history else math.nan
        line = Progress(
            episode=self.episodes,
            steps=self.steps,
            updates=self.updates,
            epsilon=self.epsilon,
            loss=float(np.mean(self.losses)) if self.losses else before,
            reward=reward,
            score=score,
            success=success,
            length=length,
            validation=self.validation.score,
            validation_optimum=self.validation.optimum,
            cpu_seconds=self.cpu_seconds,
        )
        self.losses = []
        self.history.append(line)
        return line

    @property
    def epsilon(self) -> float:
        """The current probability of a random action."""
        config = self.config
        if config.exploration == "linear":
            return linear(config.epsilon_start, config.epsilon_end, config.epsilon_steps, self.steps)
        return multiplicative(config.epsilon_start, config.epsilon_end, config.epsilon_factor, self.episodes)

    @property
    def learning_rate(self) -> float:
        """The current learning rate."""
        config = self.config
        return linear(config.learning_rate, config.final_learning_rate, config.episodes, self.episodes)

    def q_values(
        self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32], network: PathQNet
    ) -> npt.NDArray[np.float32]:
        """The network's values of the actions, float32[N, 5]."""
        with torch.no_grad():
            return network(self.tensor(grids), self.tensor(telemetry)).cpu().numpy()

    def act(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The actions of the validated network, int64[N]."""
        return self.q_values(grids, telemetry, self.eval_network).argmax(axis=1)

    def tensor(self, array: Array) -> Tensor:
        """The array on the training device."""
        return torch.from_numpy(array).to(self.device)

    def get_state(self) -> dict[str, Any]:
        """The state of the training as tensors and plain values."""
        return super().get_state() | {
            "returns": self.returns.tolist(),
            "numbers": self.numbers.tolist(),
            "replay": {name: torch.from_numpy(array) for name, array in self.replay.get_state().items()},
            "rng": self.rng.bit_generator.state,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from a state of `get_state`."""
        super().set_state(state)
        self.returns, self.numbers = np.array(state["returns"]), np.array(state["numbers"])
        self.replay.set_state({name: tensor.numpy() for name, tensor in state["replay"].items()})
        self.rng.bit_generator.state = state["rng"]

    def metadata(self) -> dict[str, Any]:
        """The metadata of the exported network."""
        return super().metadata() | {"episodes": self.episodes}
