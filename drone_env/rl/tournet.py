"""Training of the tour network by distillation of exact values.

For each state the network is fitted to a soft choice, which gives each option exp(-regret / temperature), as in policy
distillation (Rusu et al., 2016); the loss adds the expected regret, and a second output learns whether an option keeps
all parcels that can still be delivered. The exported network is the moving average of the weights (Polyak and Juditsky,
1992).

A thread generates a chunk of samples for every update. Its states depend on the seed and its number alone, so a resumed
run generates the last ones again and continues bit for bit.
"""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, logsigmoid

from drone_env.agents.tour_features import SHORT_TIME, Features
from drone_env.agents.tournet import TourFlyer
from drone_env.core.seeds import SPLITS
from drone_env.core.tasks import TaskConfig
from drone_env.errors import InvalidValueError, TooLargeError
from drone_env.rl.common import BaseTrainer, Validator, clone_state, figure, update_average
from drone_env.rl.config import TourConfig, randomise
from drone_env.rl.model import TourNet
from drone_env.rl.samples import SampleGenerator, Samples

CHUNKS = 4
"""Number of chunks in a batch."""
MAX_REGRET = 0.1
"""Maximum regret in the loss: the completion covers a parcel more or less."""
AHEAD = 3
"""Number of chunks that are generated ahead."""


class TourBatch:
    """States and their options as tensors.

    Args:
        features: The features of the states.
        values: float32[options], the values of the options.
        parcels: int8[options], the parcels that a best flight after each option has delivered.
    """

    def __init__(self, features: Features, values: npt.NDArray[np.float32], parcels: npt.NDArray[np.int8]) -> None:
        counts = np.diff(features.begins)
        owner = np.repeat(np.arange(len(counts)), counts)
        self._size = (len(counts), int(counts.max(initial=1)))
        column = np.arange(len(owner)) - np.repeat(features.begins[:-1], counts)
        self._at = torch.from_numpy(owner), torch.from_numpy(column)
        token = features.token.astype(np.int64)
        arrays = (features.tokens, features.present, features.edges, owner, token, features.options)
        self.inputs = tuple(torch.from_numpy(array) for array in arrays)
        """The inputs of the network."""
        self.values = torch.from_numpy(values)
        self.parcels = torch.from_numpy(parcels).float()

    def table(self, values: Tensor, missing: float) -> Tensor:
        """One row for each state of a number for each option, float32[states, most options]."""
        return torch.full(self._size, missing).index_put(self._at, values)


def sample_batch(window: Sequence[Samples], size: int, rng: np.random.Generator) -> TourBatch:
    """Sample states from four chunks, as many from each, with replacement.

    Args:
        window: Chunks of one task, none of them empty.
        size: Number of states, a multiple of 4.
        rng: The source of randomness.
    """
    parts: list[tuple[npt.NDArray[Any], ...]] = []
    chunks = [window[int(rng.integers(len(window)))] for _ in range(CHUNKS)]
    most = max(features.tokens.shape[1] for features, *_ in chunks)
    for features, values, parcels in chunks:
        padding = (0, most - features.tokens.shape[1])
        chosen = rng.integers(0, len(features.tokens), size // CHUNKS)
        counts: npt.NDArray[np.int64] = np.diff(features.begins)[chosen]
        shifts: npt.NDArray[np.int64] = features.begins[chosen] - np.cumsum(counts) + counts
        options: npt.NDArray[np.int64] = np.repeat(shifts, counts) + np.arange(int(counts.sum()))
        by_state = (
            np.pad(features.tokens[chosen], ((0, 0), padding, (0, 0))),
            np.pad(features.present[chosen], ((0, 0), padding)),
            np.pad(features.edges[chosen], ((0, 0), padding, padding, (0, 0))),
            counts,
        )
        by_option = (features.token, features.options, features.numbers, values, parcels)
        parts.append((*by_state, *(array[options] for array in by_option)))
    tokens, present, edges, counts, *by_option, values, parcels = map(np.concatenate, zip(*parts, strict=True))
    return TourBatch(Features(tokens, present, edges, np.append(0, np.cumsum(counts)), *by_option), values, parcels)


def choice_logits(preference: Tensor, completion: Tensor) -> Tensor:
    """The logits of the choice: options that probably lose a parcel become unlikely."""
    return preference + 2 * logsigmoid(completion)


def distillation_losses(
    preference: Tensor, completion: Tensor, batch: TourBatch, temperature: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Cross-entropy of the choices, expected regret, and cross-entropy of the completions: means over a batch.

    Args:
        preference: float32[options], the network's preferences.
        completion: float32[options], the logits of whether each option keeps all parcels that can still be delivered.
        batch: The batch.
        temperature: Regret at which the target probability is 1 / e of the best option's.
    """
    logits = batch.table(choice_logits(preference, completion), -math.inf)
    values = batch.table(batch.values, -math.inf)
    regrets = values.amax(1, keepdim=True) - values
    # At most the cost of a step: else equal mistakes would count for less on larger maps. Units do not count: a pad
    # refunds them, so a temperature of their cost makes the way back to a pad look as good as the way on.
    step_cost = batch.inputs[0][:, 0, SHORT_TIME] / 400
    target = (-regrets / step_cost.clamp(max=temperature)[:, None]).softmax(1)
    log_probs = logits.log_softmax(1)
    missing = ~torch.isfinite(values)
    choice = -(target * log_probs.masked_fill(missing, 0)).sum(1).mean()
    regret = (log_probs.exp() * regrets.clamp(max=MAX_REGRET).masked_fill(missing, 0)).sum(1).mean()
    most = batch.table(batch.parcels, -1.0).amax(1)
    keeps = batch.parcels == most[batch.inputs[3]]
    return choice, regret, binary_cross_entropy_with_logits(completion, keeps.float())


@dataclass(frozen=True)
class TourProgress:
    """One line of a training's log.

    Attributes:
        update: Updates so far.
        states: States in all batches so far.
        learning_rate: The current one.
        choice: Mean cross-entropy of the choices since the previous line.
        regret: Mean expected regret of a choice, in score, likewise.
        completion: Mean cross-entropy of the completions, likewise.
        validation: Mean optimality ratio of the tasks, at the last validation; NaN before it.
        validation_optimum: 1.
        cpu_seconds: Processor time of this training.
        ratios: The optimality ratio of each task, at the last validation; NaN before it.
    """

    update: int
    states: int
    learning_rate: float
    choice: float
    regret: float
    completion: float
    validation: float
    validation_optimum: float
    cpu_seconds: float
    ratios: dict[str, float]

    @property
    def summary(self) -> str:
        """The line, abridged for the progress bar."""
        validation = f"validation {figure(self.validation, 4)}"
        return f"{validation}  regret {figure(self.regret, 5)}  completion {self.completion:.4f}"


class TourTrainer(BaseTrainer):
    """One training of a tour network, from its first update or from a checkpoint.

    Args:
        config: The settings.
    """

    modules = ("online", "average", "optimizer")
    variables = ("updates", "states", "losses", "ratios", "cpu_seconds")
    progress = TourProgress
    config: TourConfig

    def __init__(self, config: TourConfig) -> None:
        super().__init__(config)
        sampled = config.sampled_tasks()
        self._task_shares = np.array(list(sampled.values()))
        self._windows: list[deque[Samples]] = [deque(maxlen=config.window) for _ in sampled]
        self._validators = {task.short_name: Validator(task, config.validation_maps) for task in config.tasks()}
        self._flyers = {task.short_name: TourFlyer(task, self._logits) for task in config.tasks()}
        self.online = TourNet()
        self.average = deepcopy(self.online)
        self.optimizer = torch.optim.AdamW(
            self.online.parameters(), config.learning_rate, betas=(0.9, 0.99), weight_decay=config.weight_decay
        )
        self.states = 0
        self.losses: list[tuple[float, float, float]] = []
        self.ratios: dict[str, float] = {}
        """The optimality ratio of each task at the last validation."""
        self.cpu_seconds = 0.0
        self._generators = [self._generator(task) for task in sampled]

    def _generator(self, task: TaskConfig) -> SampleGenerator:
        return SampleGenerator(task, self.config.maps_per_chunk, self.config.states_per_map)

    def train(self) -> Iterator[list[TourProgress]]:
        """Train until `config.updates` updates; yields the new log lines after each update.

        The caller may save the state between two updates, or stop.
        """
        with ThreadPoolExecutor(1) as thread:
            self._fill_windows(thread)
            ahead: deque[Future[Samples]] = deque()
            try:
                while self.updates < self.config.updates:
                    while len(ahead) < AHEAD:
                        ahead.append(thread.submit(self._generate, self.updates + len(ahead)))
                    self._windows[self._task_of(self.updates)].append(ahead.popleft().result())
                    self._update()
                    yield self._log()
            finally:
                thread.shutdown(cancel_futures=True)

    def _rng(self, chunk: int, use: int) -> np.random.Generator:
        return np.random.default_rng((self.config.seed, chunk, use))

    def _task_of(self, chunk: int) -> int:
        """The index of a chunk's task."""
        return int(self._rng(chunk, 0).choice(len(self._task_shares), p=self._task_shares))

    def _generate(self, chunk: int) -> Samples:
        rng, train = self._rng(chunk, 1), SPLITS["train"]
        seeds = rng.integers(train.start, train.stop, self.config.maps_per_chunk)
        generator = self._generators[self._task_of(chunk)]
        if rng.random() < self.config.randomised:
            with suppress(TooLargeError):  # then the task stays as it is
                generator = self._generator(randomise(generator.task, rng))
        return generator.generate(seeds)

    def _fill_windows(self, thread: ThreadPoolExecutor) -> None:
        """Generate the last chunks of a resumed run again."""
        for window in self._windows:
            window.clear()
        missing = [self.config.window] * len(self._windows)
        again: list[int] = []
        for chunk in range(self.updates - 1, -1, -1):
            task = self._task_of(chunk)
            if missing[task]:
                again.append(chunk)
                missing[task] -= 1
            if not any(missing):
                break
        again.reverse()
        for chunk, samples in zip(again, thread.map(self._generate, again), strict=True):
            self._windows[self._task_of(chunk)].append(samples)

    def _update(self) -> None:
        """Fit the network to one batch."""
        config, rng = self.config, self._rng(self.updates, 2)
        shares = self._task_shares * [any(len(samples.values) for samples in window) for window in self._windows]
        if not shares.any():
            raise InvalidValueError("no sample has options of different value: raise maps_per_chunk or states_per_map")
        window = self._windows[int(rng.choice(len(shares), p=shares / shares.sum()))]
        batch = sample_batch([samples for samples in window if len(samples.values)], config.batch_size, rng)
        preference, completions = self.online(*batch.inputs)
        choice, regret, completion = distillation_losses(preference, completions, batch, config.temperature)
        loss = choice + config.regret_weight * regret + config.completion_weight * completion
        if not loss.isfinite():
            raise InvalidValueError(f"loss NaN after {self.updates} updates: lower learning_rate, or raise warm_up")
        self.fit(loss, self.learning_rate)
        self.states += config.batch_size
        # The average covers fewer updates at first, to forget the initial weights.
        update_average(self.average, self.online, 1 - min(config.average, 1 - 1 / (self.updates / 10 + 1)))
        self.losses.append((choice.item(), regret.item(), completion.item()))

    @property
    def learning_rate(self) -> float:
        """The current learning rate: linear warm-up, then a cosine decay."""
        config = self.config
        decay = (1 + math.cos(math.pi * (self.updates / config.updates))) / 2
        rate = config.final_learning_rate + (config.learning_rate - config.final_learning_rate) * decay
        return rate * min(1.0, (self.updates + 1) / (config.warm_up + 1))

    def _log(self) -> list[TourProgress]:
        """Validate and log if it is due; the new line of the log, if there is one."""
        config, last = self.config, self.updates == self.config.updates
        if self.updates % config.validation_every == 0 or last:
            self.validate()
        if self.updates % config.log_every and not last:
            return []
        choice, regret, completion = np.mean(self.losses, axis=0).tolist()
        self.losses = []
        ratios = {name: self.ratios.get(name, math.nan) for name in self._validators}
        mean, rate, seconds = float(np.mean(list(ratios.values()))), self.learning_rate, self.cpu_seconds
        line = TourProgress(self.updates, self.states, rate, choice, regret, completion, mean, 1.0, seconds, ratios)
        self.history.append(line)
        return [line]

    def validate(self) -> None:
        """Fly the validation maps of each task with the average of the weights."""
        for name, validator in self._validators.items():
            flyer = self._flyers[name]
            result = validator.validate(flyer.act_batch, flyer.reset_batch)
            self.ratios[name] = result.score / result.optimum
        self.best = clone_state(self.average)

    def _logits(self, features: Features) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """The average of the weights as an agent takes it: choice and completion logits of each option."""
        options = len(features.token)
        batch = TourBatch(features, np.zeros(options, np.float32), np.zeros(options, np.int8))
        with torch.no_grad():
            preference, completion = self.average(*batch.inputs)
        return choice_logits(preference, completion).numpy(), completion.numpy()

    @property
    def result(self) -> str:
        """The optimality ratio of each task, for people."""
        return ", ".join(f"{name} {figure(ratio, 4)}" for name, ratio in self.ratios.items()) + " of the optimum"

    def metadata(self) -> dict[str, Any]:
        """The metadata of the exported network."""
        return {
            "network": "tournet",
            "kind": "distilled",
            "tasks": {task.id: task.version for task in self.config.tasks()},
            "config": self.config.identity(),
            "updates": self.updates,
            "states": self.states,
            "validation_shares": {name: None if math.isnan(ratio) else ratio for name, ratio in self.ratios.items()},
        }
