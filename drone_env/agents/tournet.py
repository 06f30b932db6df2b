"""The agent that flies by the tour network."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import StatelessAgent
from drone_env.agents.weights_file import WEIGHTS
from drone_env.core.actions import Action
from drone_env.core.tasks import TaskConfig
from drone_env.errors import CheckpointError

if TYPE_CHECKING:
    from drone_env.agents.tour_features import FeatureEncoder, Features

SHIPPED = WEIGHTS / "tournet_v1.safetensors"
"""The shipped network, for all tasks."""
TourForward = Callable[["Features"], tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]]
"""From features to two logits of each option, float32[options] each: its choice, and whether the mission can be
completed after it."""
TIE = 1e-4
"""Closer logits are equal: the size of a batch changes their last bits."""


class TournetAgent(StatelessAgent):
    """Takes the first action of the option that the network prefers: a path to a parcel or pad, or a charge.

    One network flies any task, of any size. Not thread-safe.

    Args:
        task: The task.
        network: The file of an exported tour network; None for the shipped one.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it holds no tour network.
        TooLargeError: if the features of a state would take too much memory.
    """

    def __init__(self, task: TaskConfig, network: Path | None = None) -> None:
        # Imported lazily: importing the compiler takes seconds.
        from drone_env.agents.tour_features import FeatureEncoder
        from drone_env.agents.tour_network import load_tour_network

        self._network = load_tour_network(SHIPPED if network is None else network)
        self._encoder = FeatureEncoder(task)
        self.config: Mapping[str, object] = {"agent": "tournet", "version": 1, "network": self._network.digest}

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N]; WAIT if no stop is within reach."""
        return choose(self._encoder, self._network, grids, telemetry)


def choose(
    encoder: "FeatureEncoder", network: "TourForward", grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]
) -> npt.NDArray[np.int64]:
    """The first actions of the options that a network prefers, int64[N]; WAIT if there is none.

    Args:
        encoder: The encoder of the task.
        network: The network.
        grids: uint8[N, height, width]
        telemetry: float32[N, telemetry_size]
    """
    actions = np.full(len(grids), Action.WAIT, np.int64)
    for i in range(0, len(grids), encoder.most):
        some = slice(i, i + encoder.most)
        features = encoder(grids[some], telemetry[some])
        options = best_options(features, network(features)[0])
        actions[some][options >= 0] = features.numbers[options[options >= 0], 2]
    return actions


def best_options(features: "Features", choices: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
    """The index of the first option with the highest logit of each state, int64[M]; -1 if there is none.

    Args:
        features: The features of M states.
        choices: float32[options], the logits.

    Raises:
        CheckpointError: if a logit is no number: the network's parameters are too large.
    """
    if not np.isfinite(choices).all():
        raise CheckpointError("the tour network returned NaN or infinity: its parameters are too large")
    best = np.full(len(features.begins) - 1, -1, np.int64)
    some = np.flatnonzero(np.diff(features.begins))
    begins = features.begins[some]
    if len(some):
        highest = np.repeat(np.maximum.reduceat(choices, begins), np.diff(features.begins)[some])
        # The first of each state is the first at or after the state's options.
        high = np.flatnonzero(highest - choices < TIE)
        best[some] = high[np.searchsorted(high, begins)]
    return best
