"""What the trainers share: validation, and the check of a checkpoint's settings."""

import ctypes
import math
import sys
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn

from drone_env.agents.batch_rollout import ActBatch, rollout_batch
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import TaskConfig
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
    success: float
    """Share of maps with all parcels delivered."""


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

    def validate(self, act: ActBatch) -> Validation:
        """Fly each map once; `act` is stateless."""
        ends = rollout_batch(self._task, self._seeds, act, stateless=True)
        success = ends.deliveries_done == self._task.deliveries
        return Validation(float(ends.scores.mean()), self.optimum, float(success.mean()))


def require_same(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> None:
    """Check that a checkpoint has these settings.

    Raises:
        CheckpointError: if it has not; the message names some that differ.
    """
    if changed := differences(theirs, ours):
        more = f" and {len(changed) - MAX_NAMED} more" if len(changed) > MAX_NAMED else ""
        raise CheckpointError(f"the checkpoint has other settings: {', '.join(changed[:MAX_NAMED])}{more}; use those")


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
