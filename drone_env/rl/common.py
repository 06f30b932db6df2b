"""What the trainers share: the state of a checkpoint, and validation."""

import ctypes
import math
import sys
import time
from collections.abc import Callable
from copy import deepcopy
from dataclasses import asdict
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from drone_env.agents.base import ActBatch, rollout_batch
from drone_env.core.batch import Batch
from drone_env.core.rewards import get_reward_profile, profile_for_discount
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import CheckpointError
from drone_env.files import differences
from drone_env.planning.optimal import best_of

MAX_NAMED = 2
"""Settings that a message names: it fits two lines."""


class Validation(NamedTuple):
    """The result of flying the validation maps."""

    score: float
    """Mean graded score."""
    optimum: float
    """Mean exact optimum of the same maps; NaN if one of them is too large to be solved."""


class Validator:
    """Flies the first maps of the validation split, which training never sees.

    Args:
        task: The task.
        maps: Number of maps.
    """

    def __init__(self, task: TaskConfig, maps: int) -> None:
        self._task = task
        self._seeds = np.array(split_seeds("validation", maps))
        best = [best_of(task, seed) for seed in self._seeds.tolist()]
        self.optimum = float(np.mean([math.nan if one is None else one.score for one in best]))

    def validate(self, act: ActBatch, reset: Callable[[npt.NDArray[np.int64]], None] | None = None) -> Validation:
        """Fly each map once; `act` is stateless, unless `reset` makes it forget the last maps."""
        begin = partial(reset, self._seeds) if reset else lambda: None
        ends = rollout_batch(self._task, self._seeds, act, reset is None, reset=begin)
        return Validation(float(ends.scores.mean()), self.optimum)


def figure(value: float, digits: int) -> str:
    """A number with this many decimal places; `-` for NaN."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"


def clone_state(network: nn.Module) -> dict[str, torch.Tensor]:
    """A copy of a network's parameters."""
    return {name: tensor.clone() for name, tensor in network.state_dict().items()}


@torch.no_grad()
def update_average(average: nn.Module, network: nn.Module, weight: float) -> None:
    """Move each parameter of `average` towards `network` by this weight (Polyak averaging)."""
    for mean, parameter in zip(average.parameters(), network.parameters(), strict=True):
        mean.lerp_(parameter, weight)


class BaseTrainer:
    """What a `TrainingRun` needs of a trainer, beside `train()`, `result` and `metadata()`.

    A subclass names its networks and optimisers in `modules`, the other attributes that a checkpoint contains in
    `variables`, and the class of its log lines in `progress`. `online` is the network that learns.

    Args:
        config: The settings.
    """

    modules: ClassVar[tuple[str, ...]] = ()
    variables: ClassVar[tuple[str, ...]] = ()
    progress: ClassVar[Any]
    config: Any
    online: Any
    optimizer: torch.optim.Optimizer
    updates: int = 0

    def __init__(self, config: Any) -> None:
        keep_freed_memory()
        torch.set_num_threads(config.num_threads)
        torch.manual_seed(config.seed)
        self.config = config
        self.history: list[Any] = []
        """The lines of the log."""
        self.best: dict[str, torch.Tensor] = {}
        """The parameters of the network to export; empty before the first validation."""

    def fit(self, loss: torch.Tensor, learning_rate: float) -> None:
        """Update the network that learns by the gradient of a loss."""
        self.optimizer.param_groups[0]["lr"] = learning_rate
        self.optimizer.zero_grad()
        loss.backward()
        if self.config.max_grad_norm:
            nn.utils.clip_grad_norm_(self.online.parameters(), self.config.max_grad_norm)
        self.optimizer.step()
        self.updates += 1

    @property
    def cpu_seconds(self) -> float:
        """Processor time of this training, including the parts before a resume."""
        return time.process_time() - self._cpu_since

    @cpu_seconds.setter
    def cpu_seconds(self, seconds: float) -> None:
        self._cpu_since = time.process_time() - seconds

    def get_state(self) -> dict[str, Any]:
        """The state of the training as tensors and plain values."""
        return {
            "config": self.config.identity(),
            **{name: getattr(self, name).state_dict() for name in self.modules},
            **{name: deepcopy(getattr(self, name)) for name in ("best", *self.variables)},
            "history": [asdict(line) for line in self.history],
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from a state of `get_state`.

        Raises:
            CheckpointError: if the state is of a training with other settings; the message names some that differ.
        """
        if changed := differences(state["config"], self.config.identity()):
            more = f" and {len(changed) - MAX_NAMED} more" if len(changed) > MAX_NAMED else ""
            named = ", ".join(changed[:MAX_NAMED])
            raise CheckpointError(f"the checkpoint has other settings: {named}{more}; use those")
        for name in self.modules:
            getattr(self, name).load_state_dict(state[name])
        for name in ("best", *self.variables):
            setattr(self, name, deepcopy(state[name]))
        self.history = [self.progress(**line) for line in state["history"]]


class TaskTrainer(BaseTrainer):
    """What the trainers of one task share: environments that step together, and the best network by validation."""

    def __init__(self, config: Any) -> None:
        super().__init__(config)
        self.task = get_task(config.task)
        profile = profile_for_discount(get_reward_profile(config.reward_profile), config.gamma)
        self.batch = Batch(self.task, config.num_envs, profile, same_step=True)
        self.validator = Validator(self.task, config.validation_maps)
        self.validation = Validation(math.nan, self.validator.optimum)
        self.best_score = -1.0
        self.steps: int = 0

    def keep_best(self, network: nn.Module, act: ActBatch) -> None:
        """Fly the validation maps with a network, and keep it if it is the best so far."""
        self.validation = self.validator.validate(act)
        if self.validation.score >= self.best_score:
            self.best, self.best_score = clone_state(network), self.validation.score

    def get_state(self) -> dict[str, Any]:
        """The state of the training as tensors and plain values."""
        return super().get_state() | {
            "batch": {name: torch.from_numpy(array) for name, array in self.batch.get_state().items()},
            "validation": list(self.validation),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Continue from a state of `get_state`, as `BaseTrainer.set_state`."""
        super().set_state(state)
        self.batch.set_state({name: tensor.numpy() for name, tensor in state["batch"].items()})
        self.validation = Validation(*state["validation"])

    @property
    def result(self) -> str:
        """The score of the best network beside the optimum, for people."""
        return f"{self.best_score:.4f} of {figure(self.validator.optimum, 4)}"

    def metadata(self) -> dict[str, Any]:
        """The metadata of the exported network."""
        return {
            "task": self.task.id,
            "task_version": self.task.version,
            "telemetry_size": self.task.telemetry_size,
            "config": self.config.identity(),
            "steps": self.steps,
            "updates": self.updates,
            "validation_score": self.best_score,
            "validation_optimum": None if math.isnan(self.validator.optimum) else self.validator.optimum,
        }


def keep_freed_memory() -> None:
    """Let glibc keep up to 1 GiB that PyTorch frees; other C libraries are left alone.

    Otherwise each update returns megabytes to the kernel and faults them in again, which took up to a third of the
    training time on a CPU.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(-3, 32 << 20)  # M_MMAP_THRESHOLD
        mallopt(-1, 1 << 30)  # M_TRIM_THRESHOLD
        mallopt(-2, 64 << 20)  # M_TOP_PAD
