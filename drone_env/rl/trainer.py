"""Deep Q-learning from the batched simulator.

Mnih et al., "Human-level control through deep reinforcement learning", Nature 2015; van Hasselt, Guez, Silver, "Deep
reinforcement learning with double Q-learning", AAAI 2016; Bellemare et al., "Increasing the action gap: new operators
for reinforcement learning", AAAI 2016 (advantage learning). N episodes fly side by side; every step of all of them goes
into the replay, and after every `steps_per_update` steps the network is fitted to one batch from it.

Every end is part of the task, so nothing is bootstrapped over an end, and nothing truncates an episode before it.
"""

import math
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import mse_loss, smooth_l1_loss

from drone_env.core.batch import Batch
from drone_env.core.rewards import get_reward_profile, profile_for_discount
from drone_env.core.seeds import SPLITS
from drone_env.core.tasks import get_task
from drone_env.envs.registry import task_argument
from drone_env.errors import InvalidValueError
from drone_env.rl.config import TrainConfig
from drone_env.rl.learner import Learner, figure, keep_freed_memory, require_same
from drone_env.rl.model import PathQNet
from drone_env.rl.policy import epsilon_greedy, linear, multiplicative
from drone_env.rl.replay_buffer import ReplayBuffer
from drone_env.rl.validation import Validation, Validator

CURVES = {
    "reward": "mean reward of an episode",
    "length": "mean steps of an episode",
    "loss": "loss",
    "epsilon": "share of random actions",
    "validation": "score on validation maps",
}
LOSSES = {"huber": smooth_l1_loss, "mse": mse_loss}
Figures = tuple[float, float, bool, int]
"""The result of an episode: undiscounted sum of rewards, score, whether all was delivered, steps."""


@dataclass(frozen=True)
class Progress:
    """How a run stands: one line of its log.

    Of episodes that start together the short ones end first, and a mean over the last ends would favour them. So the
    means go through the episodes in the order of their starts, up to the first that still flies: over all that no line
    has counted yet, and over the last `log_every` at least. NaN while there are none.

    Attributes:
        episode: Episodes ended so far.
        steps: Steps flown.
        updates: Batches that the network was fitted to.
        epsilon: Share of random actions.
        loss: Mean loss of the updates since the line before, of the last ones if there were none; NaN before the first.
        reward: Mean undiscounted sum of rewards.
        score: Mean graded score.
        success: Share of episodes that delivered everything.
        length: Mean steps of an episode.
        validation: Mean score of the network alone on the validation maps, of the last validation; NaN before it.
        validation_optimum: The exact optimum of the same maps; NaN where it is not known.
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


class Trainer(Learner):
    """One training run, from its first step or from a checkpoint.

    Args:
        config: All that decides how it goes.

    Raises:
        InvalidValueError: if a GPU is asked for and there is none.
    """

    config: TrainConfig
    unit, work, curves = "episodes", "steps", CURVES

    def __init__(self, config: TrainConfig) -> None:
        if config.gpu and not torch.cuda.is_available():
            raise InvalidValueError("--gpu needs a CUDA device, and PyTorch sees none; train without it on the CPU")
        keep_freed_memory()
        torch.set_num_threads(config.num_threads)
        torch.manual_seed(config.seed)
        self.config = config
        self.task = get_task(config.task)
        self.name, self.validation_every = self.task.short_name, config.validation_every
        self.device = torch.device("cuda" if config.gpu else "cpu")
        self.rng = np.random.default_rng(config.seed)
        profile = profile_for_discount(get_reward_profile(config.reward_profile), config.gamma)
        self.batch = Batch(self.task, config.num_envs, profile, same_step=True)
        self.batch.reset(self.rng.integers(SPLITS["train"].start, SPLITS["train"].stop, config.num_envs))
        self.online = PathQNet(self.task.telemetry_size).to(self.device)
        self.target = PathQNet(self.task.telemetry_size).to(self.device)
        self.target.load_state_dict(self.online.state_dict())
        self.optimizer = torch.optim.Adam(self.online.parameters(), lr=config.learning_rate)
        self.replay = ReplayBuffer(
            config.replay_size, config.num_envs, self.task.height, self.task.width, self.task.telemetry_size
        )
        self.validator = Validator(self.task, config.validation_maps)
        self.steps = self.updates = self.episodes = 0
        self.validated_updates = -1
        self.updates_due = 0.0
        self.rewards = np.zeros(config.num_envs)
        self.numbers = np.arange(config.num_envs)
        """Which episode each flies, counted in the order of their starts."""
        self.ended: list[tuple[int, float, int, int]] = []
        """Place, score, steps and deliveries of the episodes that the last step ended, not accounted for yet."""
        self.early: dict[int, Figures] = {}
        """Episodes that have ended before an older one, by number."""
        self.window: list[Figures] = []
        """The last episodes that all older ones ended before."""
        self.untold = 0
        """How many of them no line has counted."""
        self.losses: list[float] = []
        self.history: list[Progress] = []
        self.validation = Validation(float("nan"), self.validator.optimum, float("nan"))
        self.best_score = -1.0
        self.best = {name: tensor.clone() for name, tensor in self.judged.state_dict().items()}

    def train(self) -> Iterator[list[Progress]]:
        """Fly and learn until `config.episodes` episodes have ended; yields after each step of all episodes.

        The caller may save between two steps, or ask for no more of them.

        Yields:
            The lines that the step added to the log, most often none.
        """
        while self.episodes < self.config.episodes:
            if not self.ended:  # else the run before ended amid them
                self.fly()
                if self.steps > self.config.learning_starts and self.replay.can_sample(self.config.n_step):
                    self.updates_due += self.config.num_envs / self.config.steps_per_update
                while self.updates_due >= 1:
                    self.learn()
                    self.updates_due -= 1
            yield self.finish_episodes()

    def fly(self) -> None:
        """Fly one step in every episode and keep it."""
        batch = self.batch
        grids, telemetry = batch.grids.copy(), batch.telemetry.copy()
        actions = epsilon_greedy(self.values(grids, telemetry, self.online), self.epsilon, self.rng)
        batch.step(actions)
        self.replay.add(grids, telemetry, actions, batch.rewards * self.config.reward_scale, batch.terminated)
        self.rewards += batch.rewards
        self.steps += self.config.num_envs
        finals = batch.finals()
        columns = (batch.ended, finals["score"], finals["steps"], finals["deliveries"])
        self.ended = list(zip(*(column.tolist() for column in columns), strict=True))

    def learn(self) -> None:
        """Fit the network to one batch of the replay."""
        config = self.config
        sampled = self.replay.sample(config.batch_size, config.n_step, config.gamma, self.rng)
        grids, telemetry, actions, returns, discounts, next_grids, next_telemetry = map(self.tensor, sampled)
        actions = actions.unsqueeze(1)
        with torch.no_grad():
            next_values = self.target(next_grids, next_telemetry)
            chooser = self.online(next_grids, next_telemetry) if config.double else next_values
            next_value = next_values.gather(1, chooser.argmax(1, keepdim=True)).squeeze(1)
            wanted = returns + discounts * next_value
            if config.advantage_learning:
                present = self.target(grids, telemetry)
                wanted += config.advantage_learning * (present.gather(1, actions).squeeze(1) - present.amax(1))

        values = self.online(grids, telemetry).gather(1, actions).squeeze(1)
        loss = LOSSES[config.loss](values, wanted)
        self.optimizer.zero_grad()
        loss.backward()
        if config.max_grad_norm:
            torch.nn.utils.clip_grad_norm_(self.online.parameters(), config.max_grad_norm)
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate
        self.optimizer.step()
        self.losses.append(float(loss.item()))
        self.updates += 1
        if config.target_update == "soft":
            with torch.no_grad():
                for ours, theirs in zip(self.target.parameters(), self.online.parameters(), strict=True):
                    ours.lerp_(theirs, config.tau)

    def finish_episodes(self) -> list[Progress]:
        """Account for the episodes that the last step ended, up to the last that is wanted; validate and log.

        Those beyond it are left for a run that goes on.
        """
        config = self.config
        lines: list[Progress] = []
        while self.ended and self.episodes < config.episodes:
            i, score, steps, deliveries = self.ended.pop(0)
            number, self.numbers[i] = int(self.numbers[i]), self.episodes + config.num_envs
            self.early[number] = (float(self.rewards[i]), score, deliveries == self.task.deliveries, steps)
            self.rewards[i] = 0.0
            self.episodes += 1
            if config.target_update == "episodes" and self.episodes % config.target_every == 0:
                self.target.load_state_dict(self.online.state_dict())
            due = self.episodes % config.validation_every == 0 or self.episodes == config.episodes
            if due and self.updates != self.validated_updates:
                self.validate()
            if self.episodes % config.log_every == 0 or self.episodes == config.episodes:
                lines.append(self.log())
        return lines

    def validate(self) -> None:
        """Fly the validation maps with the network alone; keep it if it is the best so far."""
        self.validation = self.validator.validate(lambda grids, seen: self.values(grids, seen).argmax(axis=1))
        self.validated_updates = self.updates
        if self.validation.score >= self.best_score:
            self.best_score = self.validation.score
            self.best = {name: tensor.clone() for name, tensor in self.judged.state_dict().items()}

    @property
    def judged(self) -> PathQNet:
        """The network that is validated and kept.

        A soft target is a moving average of the online network, and flies far better than it: on hard after 2,000
        updates it made 0.990 of the optimum where the online network made 0.905 (Polyak and Juditsky, "Acceleration
        of stochastic approximation by averaging", 1992). A periodic target is only older.
        """
        return self.target if self.config.target_update == "soft" else self.online

    def log(self) -> Progress:
        """The next line of the log."""
        oldest = self.numbers.min()
        come = [self.early.pop(number) for number in sorted(self.early) if number < oldest]
        self.untold += len(come)
        self.window = [*self.window, *come][-max(self.untold, self.config.log_every) :]
        reward, score, success, length = np.mean(self.window, axis=0).tolist() if self.window else [float("nan")] * 4
        last = self.history[-1].loss if self.history else float("nan")
        progress = Progress(
            episode=self.episodes,
            steps=self.steps,
            updates=self.updates,
            epsilon=self.epsilon,
            loss=float(np.mean(self.losses)) if self.losses else last,
            reward=reward,
            score=score,
            success=success,
            length=length,
            validation=self.validation.score,
            validation_optimum=self.validation.optimum,
        )
        self.losses, self.untold = [], 0
        self.history.append(progress)
        return progress

    @property
    def epsilon(self) -> float:
        """The present share of random actions."""
        config = self.config
        if config.exploration == "linear":
            return linear(config.epsilon_start, config.epsilon_end, config.epsilon_steps, self.steps)
        return multiplicative(config.epsilon_start, config.epsilon_end, config.epsilon_factor, self.episodes)

    @property
    def learning_rate(self) -> float:
        """The present step size."""
        config = self.config
        return linear(config.learning_rate, config.final_learning_rate, config.episodes, self.episodes)

    def values(
        self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32], network: PathQNet | None = None
    ) -> npt.NDArray[np.float32]:
        """The values of a network, float32[N, 5]; of the one that is judged, if none is named."""
        with torch.no_grad():
            return (network or self.judged)(self.tensor(grids), self.tensor(telemetry)).cpu().numpy()

    def tensor(self, array: npt.NDArray[Any]) -> Tensor:
        """The array on the device that trains."""
        return torch.from_numpy(array).to(self.device)

    def get_state(self) -> dict[str, Any]:
        """Everything that the run needs to go on, as tensors and plain values."""
        return {
            "config": self.config.identity(),
            "episodes_wanted": self.config.episodes,
            **{name: getattr(self, name).state_dict() for name in LEARNED},
            **{name: copy(getattr(self, name)) for name in PLAIN},
            **{name: torch.from_numpy(getattr(self, name)) for name in PLACES},
            "counters": [getattr(self, name) for name in COUNTERS],
            "replay": {
                name: torch.from_numpy(getattr(self.replay, name)[: self.replay.held]) for name in REPLAY_ARRAYS
            },
            "replay_added": self.replay.added,
            "batch": {name: as_tensor(array) for name, array in self.batch.get_state().items()},
            "rng": self.rng.bit_generator.state,
            "history": [vars(progress) for progress in self.history],
            "validation": list(self.validation),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Go on where `get_state` stood.

        Raises:
            CheckpointError: if the state is of a run with another configuration, whose differences the message names.
        """
        require_same(self.config.identity(), state["config"])
        for name in LEARNED:
            getattr(self, name).load_state_dict(state[name])
        for name in PLAIN:
            setattr(self, name, copy(state[name]))
        for name in PLACES:
            getattr(self, name)[:] = state[name].cpu().numpy()
        for name, value in zip(COUNTERS, state["counters"], strict=True):
            setattr(self, name, value)
        for name in REPLAY_ARRAYS:
            stored = state["replay"][name].cpu().numpy()
            getattr(self.replay, name)[: len(stored)] = stored
        self.replay.added = state["replay_added"]
        own = self.batch.get_state()
        self.batch.set_state({name: state["batch"][name].cpu().numpy().view(own[name].dtype) for name in own})
        self.rng.bit_generator.state = state["rng"]
        self.history = [Progress(**line) for line in state["history"]]
        self.validation = Validation(*state["validation"])

    @property
    def checkpoint_gap(self) -> tuple[int, float]:
        """At least so many episodes and seconds lie between two checkpoints."""
        return self.config.checkpoint_episodes, self.config.checkpoint_seconds

    @property
    def result(self) -> str:
        """The score of the best network, beside the optimum."""
        return f"{self.best_score:.4f} of {figure(self.validator.optimum, 4)}"

    @property
    def judged_by(self) -> str:
        """What `drone-env evaluate` takes to judge it."""
        return f"--task {task_argument(get_task(self.config.task))} --agents greedy pathqnet"

    @property
    def how_to_go_on(self) -> str:
        """More episodes."""
        return f"Add --episodes {2 * self.episodes} to go on. "

    def figures(self, line: Progress) -> str:
        """A line of the log in few words, for who watches."""
        validation = f"validation {figure(line.validation, 4)} of {figure(line.validation_optimum, 4)}"
        return f"{validation}  loss {figure(line.loss, 4)}  epsilon {line.epsilon:.2f}"

    def metadata(self) -> dict[str, Any]:
        """What the exported network says of itself."""
        return {
            "task": self.task.id,
            "task_version": self.task.version,
            "telemetry_size": self.task.telemetry_size,
            "config": self.config.identity(),
            "episodes": self.episodes,
            "steps": self.steps,
            "updates": self.updates,
            "validation_score": self.best_score,
            "validation_optimum": None if math.isnan(self.validator.optimum) else self.validator.optimum,
        }

    def best_network(self) -> PathQNet | None:
        """The network that flew the validation maps best, on the CPU; None before the first validation."""
        if self.best_score < 0:
            return None
        network = PathQNet(self.task.telemetry_size)
        network.load_state_dict({name: tensor.cpu() for name, tensor in self.best.items()})
        return network


# What a checkpoint holds of a trainer, by how it is kept.
LEARNED = ("online", "target", "optimizer")
PLAIN = ("best", "best_score", "ended", "early", "window", "untold", "losses")
PLACES = ("rewards", "numbers")
COUNTERS = ("steps", "updates", "episodes", "updates_due", "validated_updates")
REPLAY_ARRAYS = ("grids", "telemetry", "actions", "rewards", "terminated")


def as_tensor(array: npt.NDArray[Any]) -> Tensor:
    """The array as a tensor; unsigned 16-bit numbers, which not every PyTorch stores, as signed ones."""
    return torch.from_numpy(array.view(np.int16) if array.dtype == np.uint16 else array)
