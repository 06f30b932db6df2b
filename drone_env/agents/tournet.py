"""The agent that flies by the tour network."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from drone_env.agents.weights_file import WEIGHTS
from drone_env.core.actions import Action
from drone_env.core.cells import DELIVERY_CELL
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import CheckpointError
from drone_env.planning.from_observation import read_observations

if TYPE_CHECKING:
    from drone_env.agents.tour_features import Features

SHIPPED = WEIGHTS / "tournet_v1.safetensors"
"""The shipped network, for all tasks."""
TourForward = Callable[["Features"], tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]]
"""From features to two logits of each option, float32[options] each: its choice, and whether it keeps all parcels that
can still be delivered."""
TIE = 1e-4
"""Closer logits are equal: the size of a batch changes their last bits."""
LAST = np.float32(1e6)
"""What an option that leads nowhere loses: more than any logit."""


class TourFlyer:
    """Takes the first action of the option that a network prefers: a path to a parcel or pad, or a charge.

    It does not fly back to a pad where it has had as many units since the last delivery, unless the network expects
    every other option to lose a parcel. So it does not circle.

    Not thread-safe.

    Args:
        task: The task.
        network: The network.

    Raises:
        TooLargeError: if the features of a state would take too much memory.
    """

    def __init__(self, task: TaskConfig, network: TourForward) -> None:
        # Imported lazily: importing the compiler takes seconds.
        from drone_env.agents.tour_features import FeatureEncoder

        self._task, self._network, self._encoder = task, network, FeatureEncoder(task)
        self._forget(1)

    def _forget(self, episodes: int) -> None:
        self._left = np.full(episodes, self._task.max_steps + 1)
        """Steps left at the last observation of each episode; -1 after its end."""
        self._waiting = np.zeros(episodes, np.int64)
        """Number of parcels that waited then."""
        self._held = np.full((episodes, self._encoder.tokens), -1)
        """The most units at each pad since the last delivery, by token; -1 before the first visit."""

    def reset(self, seed: int) -> None:
        """Forget the last episode."""
        self._forget(1)

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Forget the last episodes."""
        self._forget(len(seeds))

    def act(self, observation: Observation) -> int:
        """The next action, 0 to 4, as `act_batch`."""
        return int(self.act_batch(observation["grid"][None], observation["telemetry"][None])[0])

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N]; WAIT if no stop is within reach.

        Steps left that do not fall belong to another episode: that row is ignored, with WAIT, until the next reset.
        """
        from drone_env.agents.tour_features import HERE  # as in `__init__`

        grounds, drones = read_observations(self._task, grids, telemetry)
        if len(grids) != len(self._left):
            self._forget(len(grids))
        _, units, left = drones.T
        self._left = np.where(left < self._left, left, -1)
        waiting = np.count_nonzero(grounds == DELIVERY_CELL, axis=1)
        self._held[waiting != self._waiting] = -1
        self._waiting = waiting
        actions, flying = np.full(len(grids), Action.WAIT, np.int64), np.flatnonzero(self._left >= 0)
        for i in range(0, len(flying), self._encoder.most):
            rows = flying[i : i + self._encoder.most]
            features = self._encoder.encode(grounds[rows], drones[rows])
            choices, completions = self._network(features)
            above = features.tokens[:, :, HERE] > 0  # the pads below the drones count too
            self._held[rows] = held = np.where(above, np.maximum(self._held[rows], units[rows, None]), self._held[rows])
            last = leads_nowhere(features, units[rows], held, completions)
            options = best_options(features, np.where(last, choices - LAST, choices))
            found = options >= 0
            actions[rows[found]] = features.numbers[options[found], 2]
        return actions


class TournetAgent(TourFlyer):
    """Flies any task, of any size, by one network, as `TourFlyer`.

    Args:
        task: The task.
        network: The file of an exported tour network; None for the shipped one.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it holds no tour network.
        TooLargeError: if the features of a state would take too much memory.
    """

    def __init__(self, task: TaskConfig, network: Path | None = None) -> None:
        # Imported lazily, as in the base class.
        from drone_env.agents.tour_network import load_tour_network

        loaded = load_tour_network(SHIPPED if network is None else network)
        super().__init__(task, loaded)
        self.config: Mapping[str, object] = {"agent": "tournet", "version": 2, "network": loaded.digest}


def leads_nowhere(
    features: "Features",
    units: npt.NDArray[np.int64],
    held: npt.NDArray[np.int64],
    keeps: npt.NDArray[np.float32],
) -> npt.NDArray[np.bool_]:
    """Whether an option leads to a pad with no more units than before, while another may lose no parcel: bool[options].

    Args:
        features: The features of M states.
        units: int64[M], units left.
        held: int64[M, tokens], the most units at each pad.
        keeps: float32[options], logits of whether an option loses no parcel.
    """
    owner = np.repeat(np.arange(len(units)), np.diff(features.begins))
    drained = features.numbers[:, 0]  # below zero for a charge
    back = (drained > 0) & (held[owner, features.token] >= units[owner] - drained)
    another = np.zeros(len(units), np.bool_)
    another[owner[~back & (keeps > 0)]] = True
    return back & another[owner]


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
