"""What every learner is to the run that trains it and keeps its files."""

import ctypes
import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any, TypeVar

import torch
from torch import nn

from drone_env.errors import CheckpointError


class Learner(ABC):
    """A training that can be stopped after each of its steps, saved, and gone on with."""

    unit: str
    """What is counted, episodes or updates: an attribute, and what the configuration calls how many there are to be."""
    curves: Mapping[str, str]
    """What to draw: fields of the log's lines, and what they are."""
    name: str
    """Of its files."""
    work: str
    """An attribute, and field of the log's lines, that tells how much has been worked through."""
    config: Any
    validation_every: int
    """How many lie between two validations."""
    device: torch.device
    history: list[Any]
    """The lines of the log: dataclasses whose first field is the count."""

    @property
    def done(self) -> int:
        """How many so far."""
        return getattr(self, self.unit)

    @property
    def wanted(self) -> int:
        """How many in all."""
        return getattr(self.config, self.unit)

    @property
    def worked(self) -> int:
        """How much has been worked through."""
        return getattr(self, self.work)

    @property
    @abstractmethod
    def checkpoint_gap(self) -> tuple[int, float]:
        """At least so many, and so many seconds, lie between two checkpoints."""

    @abstractmethod
    def train(self) -> Iterator[list[Any]]:
        """Go on to the end; yields, after each step, the lines that it added to the log.

        The caller may save between two steps, or ask for no more of them.
        """

    @abstractmethod
    def get_state(self) -> dict[str, Any]:
        """Everything that the training needs to go on, as tensors and plain values."""

    @abstractmethod
    def set_state(self, state: dict[str, Any]) -> None:
        """Go on where `get_state` stood.

        Raises:
            CheckpointError: if the state is of a run with another configuration, whose differences the message names.
        """

    @abstractmethod
    def best_network(self) -> nn.Module | None:
        """The network to keep; None before the first validation."""

    @abstractmethod
    def metadata(self) -> dict[str, Any]:
        """What the exported network says of itself."""

    @property
    @abstractmethod
    def result(self) -> str:
        """How well the network to keep flies, in few words."""

    @property
    @abstractmethod
    def judged_by(self) -> str:
        """What `drone-env evaluate` takes to judge it."""

    @property
    def how_to_go_on(self) -> str:
        """What to say to train on after the end; empty where nothing does."""
        return ""

    @abstractmethod
    def figures(self, line: Any) -> str:
        """A line of the log in few words, for who watches."""


AnyLearner = TypeVar("AnyLearner", bound=Learner)


LATER = ("reward ", "rules of ")
"""How that begins which older checkpoints do not tell: what a reward profile holds, and which task has the name."""


MOST_NAMED = 2
"""Settings that a message names: it is to fit two lines."""


class DifferentRunError(CheckpointError):
    """A checkpoint of a run with other settings, some of which the message names."""


def require_same(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> None:
    """Check that a checkpoint is of a run with this configuration, as far as the checkpoint says.

    Raises:
        DifferentRunError: if it is not.
    """
    told = [name for name in ours if name in theirs or not name.startswith(LATER)]
    different = [f"{name} {theirs.get(name)!r} (now {ours[name]!r})" for name in told if theirs.get(name) != ours[name]]
    if different:
        more = len(different) - MOST_NAMED
        raise DifferentRunError(", ".join(different[:MOST_NAMED]) + (f" and {more} more" if more > 0 else ""))


def keep_freed_memory() -> None:
    """Have the C library keep what PyTorch frees, up to 1 GiB; where it is not glibc, do nothing.

    Each layer's output is some megabytes. Given back to the kernel and asked for again at every update, its pages are
    zeroed again one fault at a time, which took up to a third of the time of training on the CPU.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(-3, 32 << 20)  # M_MMAP_THRESHOLD, as glibc's malloc.h numbers it
        mallopt(-1, 1 << 30)  # M_TRIM_THRESHOLD
        mallopt(-2, 64 << 20)  # M_TOP_PAD


def figures_of(line: Any) -> dict[str, float]:
    """The figures of a line of the log, in order; those of `shares` are called after their tasks, `validation_hard`."""
    figures = asdict(line)
    shares = figures.pop("shares", {})
    return figures | {f"validation_{task}": share for task, share in shares.items()}


def figure(value: float, digits: int) -> str:
    """A number for people; `-` for one that there is not yet."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"
