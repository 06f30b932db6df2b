"""Distilling exact values into a tour network.

For each state the network is fitted to a soft choice, the one that gives each option exp(-regret / temperature), as
in policy distillation (Rusu et al., 2016); the expected regret is added, and a second output learns whether the mission
can still be completed after an option. What flies is the average of the weights (Polyak and Juditsky, 1992).

A chunk of lessons is drawn for every update, by a thread of its own. Which states it holds depends on the seed and on
its number alone, so that a resumed run draws the last ones again and goes on bit for bit.
"""

import math
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from copy import deepcopy
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from drone_env.agents.tour_network import load_tour_network
from drone_env.agents.tour_view import View
from drone_env.agents.tour_viewer import Viewer
from drone_env.agents.tournet import choose
from drone_env.core.seeds import SPLITS
from drone_env.core.tasks import TaskConfig
from drone_env.envs.registry import task_argument
from drone_env.errors import InvalidValueError, TooLargeError
from drone_env.rl.learner import Learner, figure, keep_freed_memory, require_same
from drone_env.rl.lessons import Lessons, Teacher
from drone_env.rl.tour_batch import Batch, chosen_by, losses_of, sample
from drone_env.rl.tour_config import ALL, TourConfig, randomise
from drone_env.rl.tour_model import TourNet
from drone_env.rl.validation import Validator

CURVES = {
    "choice": "cross-entropy of the choices",
    "regret": "expected regret of a choice, in score",
    "completion": "cross-entropy of what can be completed",
    "shares": "share of the optimum on validation maps",
}
AHEAD = 3
"""Chunks that are drawn before they are asked for."""


@dataclass(frozen=True)
class TourProgress:
    """How a run stands: one line of its log.

    Attributes:
        update: Updates so far.
        states: States that it has learned from, repeated ones included.
        learning_rate: The present one.
        choice: Mean cross-entropy of the choices since the line before.
        regret: Mean expected regret of a choice, in score, likewise.
        completion: Mean cross-entropy of the completions, likewise.
        validation: Mean over the tasks of the share of the optimum, of the last validation; NaN before it.
        validation_optimum: 1.
        cpu_seconds: Seconds that the processors have worked on this run.
        shares: The share of each task, of the last validation; NaN before it.
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
    shares: dict[str, float]


class TourTrainer(Learner):
    """One training of a tour network, from its first update or from a checkpoint.

    Args:
        config: All that decides how it goes.

    Raises:
        UnsupportedTaskError: if the exact values of a task cannot be found by legs.
        TooLargeError: if they would take too much memory.
    """

    config: TourConfig
    unit, work, curves = "updates", "states", CURVES
    kind = "distilled"
    """What it learns from."""

    def __init__(self, config: TourConfig) -> None:
        keep_freed_memory()
        torch.set_num_threads(config.num_threads)
        torch.manual_seed(config.seed)
        self.config, self.device = config, torch.device("cpu")
        tasks = config.tasks()
        self.name, self.validation_every = config.name, config.validation_every
        shares = config.lessons()
        self._shares = np.array(list(shares.values()))
        self._windows: list[deque[Lessons]] = [deque(maxlen=config.window) for _ in shares]
        self._validators = {task.short_name: Validator(task, config.validation_maps) for task in tasks}
        self._viewers = {task.short_name: Viewer(task) for task in tasks}
        self.online = TourNet()
        if config.initial:
            parameters = load_tour_network(Path(config.initial)).parameters
            self.online.load_state_dict({name: torch.from_numpy(array) for name, array in parameters.items()})
        self.average = deepcopy(self.online)
        self.optimizer = torch.optim.AdamW(
            self.online.parameters(), config.learning_rate, betas=(0.9, 0.99), weight_decay=config.weight_decay
        )
        self.updates = self.states = 0
        self._losses: list[tuple[float, float, float]] = []
        self.history: list[TourProgress] = []
        self.shares: dict[str, float] = {}
        """Share of the optimum on the validation maps of each task, of the last validation."""
        self.validated: dict[str, Tensor] = {}
        """The average of the weights at the last validation."""
        self._cpu_before, self._cpu_since = 0.0, time.process_time()
        self._prepare(list(shares))

    def _prepare(self, tasks: list[TaskConfig]) -> None:
        """Make ready what is learned from."""
        config = self.config
        self._teachers = [Teacher(task, config.maps_per_chunk, config.states_per_map) for task in tasks]

    @property
    def checkpoint_gap(self) -> tuple[int, float]:
        """At least so many updates and seconds lie between two checkpoints."""
        return 1, self.config.checkpoint_seconds

    @property
    def cpu_seconds(self) -> float:
        """Seconds that the processors have worked on this run, in all its parts."""
        return self._cpu_before + time.process_time() - self._cpu_since

    def train(self) -> Iterator[list[TourProgress]]:
        """Learn until `config.updates` updates are made; yields after each.

        The caller may save between two updates, or ask for no more of them.

        Yields:
            The lines that the update added to the log, most often none.
        """
        with ThreadPoolExecutor(1) as drawing:
            self._fill_windows(drawing)
            coming: deque[Future[Lessons]] = deque()
            try:
                while self.updates < self.config.updates:
                    while len(coming) < AHEAD:
                        coming.append(drawing.submit(self._draw, self.updates + len(coming)))
                    self._windows[self._subject(self.updates)].append(coming.popleft().result())
                    self._learn()
                    yield self._log()
            finally:
                drawing.shutdown(cancel_futures=True)

    def _random(self, chunk: int, use: int) -> np.random.Generator:
        return np.random.default_rng((self.config.seed, chunk, use))

    def _subject(self, chunk: int) -> int:
        """The number of the task that a chunk is drawn on."""
        return int(self._random(chunk, 0).choice(len(self._shares), p=self._shares))

    def _draw(self, chunk: int) -> Lessons:
        config, random = self.config, self._random(chunk, 1)
        train = SPLITS["train"]
        seeds = random.integers(train.start, train.stop, config.maps_per_chunk)
        teacher = self._teachers[self._subject(chunk)]
        if random.random() < config.randomised:
            with suppress(TooLargeError):  # such numbers are left out
                teacher = Teacher(randomise(teacher.task, random), config.maps_per_chunk, config.states_per_map)
        return teacher.draw(seeds)

    def _fill_windows(self, drawing: ThreadPoolExecutor) -> None:
        """Draw again what a run that goes on had drawn last."""
        for window in self._windows:
            window.clear()
        missing = [self.config.window] * len(self._windows)
        again: list[int] = []
        for chunk in range(self.updates - 1, -1, -1):
            subject = self._subject(chunk)
            if missing[subject]:
                again.append(chunk)
                missing[subject] -= 1
            if not any(missing):
                break
        again.reverse()
        for chunk, lessons in zip(again, drawing.map(self._draw, again), strict=True):
            self._windows[self._subject(chunk)].append(lessons)

    def _learn(self) -> None:
        """Fit the network to one batch."""
        config, random = self.config, self._random(self.updates, 2)
        shares = self._shares * [any(len(lessons.values) for lessons in window) for window in self._windows]
        if not shares.any():
            raise InvalidValueError("no choice drawn so far matters: raise maps_per_chunk or states_per_map")
        window = self._windows[int(random.choice(len(shares), p=shares / shares.sum()))]
        batch = sample([lessons for lessons in window if len(lessons.values)], config.batch_size, random)
        preference, completions = self.online(*batch.inputs)
        choice, regret, completion = self._losses_of(preference, completions, batch)
        known = choice if regret.isnan() else choice + config.regret_weight * regret
        loss = known + config.completion_weight * completion
        if not loss.isfinite():
            raise InvalidValueError(
                f"after {self.updates} updates the loss is no number: lower learning_rate, or raise warm_up. What was "
                "saved last is as it was"
            )
        for group in self.optimizer.param_groups:
            group["lr"] = self.learning_rate
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.online.parameters(), config.max_grad_norm)
        self.optimizer.step()
        self.updates += 1
        self.states += config.batch_size
        # At first over fewer updates, so that the average forgets the weights that it began with.
        kept = min(config.average, 1 - 1 / (self.updates / 10 + 1))
        with torch.no_grad():
            for mean, weight in zip(self.average.parameters(), self.online.parameters(), strict=True):
                mean.lerp_(weight, 1 - kept)
        self._losses.append((choice.item(), regret.item(), completion.item()))

    def _losses_of(self, preference: Tensor, completion: Tensor, batch: Batch) -> tuple[Tensor, Tensor, Tensor]:
        return losses_of(preference, completion, batch, self.config.temperature)

    @property
    def learning_rate(self) -> float:
        """The present step size."""
        config = self.config
        part = self.updates / config.updates
        fallen = config.final_learning_rate
        fallen += (config.learning_rate - fallen) * (1 + math.cos(math.pi * part)) / 2
        return fallen * min(1.0, (self.updates + 1) / (config.warm_up + 1))

    def _log(self) -> list[TourProgress]:
        """The line that is due after an update, if one is; validates where that is due."""
        config, last = self.config, self.updates == self.config.updates
        if self.updates % config.validation_every == 0 or last:
            self.validate()
        if self.updates % config.log_every and not last:
            return []
        choice, regret, completion = np.mean(self._losses, axis=0).tolist()
        self._losses = []
        shares = {name: self.shares.get(name, math.nan) for name in self._validators}
        mean, rate, seconds = float(np.mean(list(shares.values()))), self.learning_rate, self.cpu_seconds
        line = TourProgress(self.updates, self.states, rate, choice, regret, completion, mean, 1.0, seconds, shares)
        self.history.append(line)
        return [line]

    def validate(self) -> None:
        """Fly the validation maps of each task with the average of the weights."""
        for name, validator in self._validators.items():
            flown = validator.validate(partial(choose, self._viewers[name], self._judged))
            self.shares[name] = flown.score / flown.optimum
        self.validated = {name: tensor.clone() for name, tensor in self.average.state_dict().items()}

    def _judged(self, view: View) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        return self._says(self.average, view)

    @staticmethod
    def _says(network: TourNet, view: View) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """What a network says of each option."""
        batch = Batch(view, np.zeros(len(view.token), np.float32))
        with torch.no_grad():
            preference, completion = network(*batch.inputs)
        return chosen_by(preference, completion).numpy(), completion.numpy()

    def get_state(self) -> dict[str, Any]:
        """Everything that the run needs to go on, as tensors and plain values."""
        return {
            "config": self.config.identity(),
            **{name: getattr(self, name).state_dict() for name in LEARNED},
            "counters": [self.updates, self.states],
            "losses": list(self._losses),
            "history": [asdict(line) for line in self.history],
            "shares": dict(self.shares),
            "validated": dict(self.validated),
            "cpu_seconds": self.cpu_seconds,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Go on where `get_state` stood.

        Raises:
            CheckpointError: if the state is of a run with another configuration, whose differences the message names.
        """
        require_same(self.config.identity(), state["config"])
        for name in LEARNED:
            getattr(self, name).load_state_dict(state[name])
        self.updates, self.states = state["counters"]
        self._losses = [tuple(losses) for losses in state["losses"]]
        self.history = [TourProgress(**line) for line in state["history"]]
        self.shares = dict(state["shares"])
        self.validated = dict(state["validated"])
        self._cpu_before, self._cpu_since = state["cpu_seconds"], time.process_time()

    def best_network(self) -> TourNet | None:
        """The average of the weights at the last validation; None before the first."""
        if not self.validated:
            return None
        network = TourNet()
        network.load_state_dict(self.validated)
        return network

    @property
    def result(self) -> str:
        """The share of the optimum that the network reaches on each task."""
        return ", ".join(f"{name} {figure(share, 4)}" for name, share in self.shares.items()) + " of the optimum"

    @property
    def judged_by(self) -> str:
        """What `drone-env evaluate` takes to judge it."""
        names = " ".join(map(task_argument, self.config.tasks()))
        return f"--task {'all' if self.config.task == ALL else names} --agents greedy tournet"

    def figures(self, line: TourProgress) -> str:
        """A line of the log in few words, for who watches."""
        regret = f"regret {figure(line.regret, 5)}  completion {line.completion:.4f}"
        return f"validation {figure(line.validation, 4)}  {regret}"

    def metadata(self) -> dict[str, Any]:
        """What the exported network says of itself."""
        return {
            "network": "tournet",
            "kind": self.kind,
            "tasks": {task.id: task.version for task in self.config.tasks()},
            "config": self.config.identity(),
            "updates": self.updates,
            "states": self.states,
            "cpu_seconds": round(self.cpu_seconds, 1),
            "validation_shares": {name: None if math.isnan(share) else share for name, share in self.shares.items()},
        }


LEARNED = ("online", "average", "optimizer")
