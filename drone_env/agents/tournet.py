"""The agent that chooses by the tour network where to fly next and by which way, every step anew."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from drone_env.agents.weights_file import WEIGHTS
from drone_env.core.actions import Action
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import CheckpointError, UnsupportedTaskError

if TYPE_CHECKING:
    from drone_env.agents.tour_network import TourNetwork
    from drone_env.agents.tour_view import View
    from drone_env.agents.tour_viewer import Viewer

SHIPPED = WEIGHTS / "tournet_v1.npz"
"""One network for all tasks."""
Network = Callable[["View"], tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]]
"""From views to two numbers for each option: the logit of its choice, and of whether the mission can then be completed;
float32[options] each."""
TIE = 1e-4
"""Logits that lie closer together count as equal: how many states are looked at together changes their last bits."""


def tour_network(network: Path | None) -> "TourNetwork":
    """The network in a file, the shipped one for None.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it holds no tour network.
        UnsupportedTaskError: if none is shipped.
    """
    # Compiles, which nobody should wait for who does not fly by it.
    from drone_env.agents.tour_network import load_tour_network

    if network is None and not SHIPPED.is_file():
        raise UnsupportedTaskError(f"no tour network is shipped as {SHIPPED}: name a file, as in tournet:FILE")
    return load_tour_network(SHIPPED if network is None else network)


class TournetAgent:
    """Of all ways that are worth flying to a parcel or a pad, and of a charge, begins the one that the network prefers.

    It flies any task, of any size, by one network. Not to be shared between threads.

    Args:
        task: The task.
        network: The file of an exported tour network; None for the shipped one.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it holds no tour network.
        TooLargeError: if what there is to see on a map of the task would take too much memory.
        UnsupportedTaskError: if no network is shipped.
    """

    stateless = True

    def __init__(self, task: TaskConfig, network: Path | None = None) -> None:
        from drone_env.agents.tour_viewer import Viewer  # as above

        self._network = tour_network(network)
        self._viewer = Viewer(task)
        self.config: Mapping[str, object] = {"agent": "tournet", "version": 1, "network": self._network.digest}

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def act(self, observation: Observation) -> int:
        """The first action of the preferred way; WAIT where nothing is within reach."""
        return int(self.act_batch(observation["grid"][None], observation["telemetry"][None])[0])

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Nothing to forget."""

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The same of many observations, int64[N]."""
        return choose(self._viewer, self._network, grids, telemetry)


def choose(
    viewer: "Viewer", network: "Network", grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]
) -> npt.NDArray[np.int64]:
    """The first actions of the options that a network prefers, int64[N]; WAIT where there is none.

    Args:
        viewer: Of the task.
        network: Of parameters that stay as they are.
        grids: uint8[N, height, width]
        telemetry: float32[N, telemetry_size]
    """
    parts: list[npt.NDArray[np.int64]] = []
    for i in range(0, len(grids), viewer.most):
        view = viewer(grids[i : i + viewer.most], telemetry[i : i + viewer.most])
        choices, _ = network(view)
        parts.append(first_actions(view, choices))
    return np.concatenate(parts)


def first_actions(view: "View", choices: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
    """The first action of the best option of each view, int64[M]; WAIT where there is none.

    Args:
        view: Of M states.
        choices: float32[options], the logits.
    """
    actions = np.full(len(view.begins) - 1, Action.WAIT, np.int64)
    options = best_options(view, choices)
    actions[options >= 0] = view.numbers[options[options >= 0], 2]
    return actions


def best_options(view: "View", choices: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
    """The number of the first option of the highest logit of each view, int64[M]; -1 where there is none.

    Args:
        view: Of M states.
        choices: float32[options], the logits.

    Raises:
        CheckpointError: if one of them is no number: the network's parameters are too large.
    """
    if not np.isfinite(choices).all():
        raise CheckpointError("the tour network has values that are no numbers: its parameters are too large to fly by")
    best = np.full(len(view.begins) - 1, -1, np.int64)
    some = np.flatnonzero(np.diff(view.begins))
    begins = view.begins[some]
    if len(some):
        highest = np.repeat(np.maximum.reduceat(choices, begins), np.diff(view.begins)[some])
        # The first of each view is found where those before it are counted.
        high = np.flatnonzero(highest - choices < TIE)
        best[some] = high[np.searchsorted(high, begins)]
    return best
