"""The agents that fly by the tour network: one that follows it at every step, and one that searches whole plans."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import StatelessAgent
from drone_env.agents.planned import PlannedAgent
from drone_env.agents.weights_file import WEIGHTS
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import TaskConfig
from drone_env.errors import CheckpointError, InvalidValueError, UnsupportedTaskError

if TYPE_CHECKING:
    from drone_env.agents.tour_encoder import FeatureEncoder
    from drone_env.agents.tour_features import Features
    from drone_env.agents.tour_network import TourNetwork

SHIPPED = WEIGHTS / "tournet_v1.safetensors"
"""The shipped network, for all tasks."""
Network = Callable[["Features"], tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]]
"""From features to two logits of each option, float32[options] each: its choice, and whether the mission can be
completed after it."""
TIE = 1e-4
"""Closer logits are equal: the size of a batch changes their last bits."""


def tour_network(network: Path | None) -> "TourNetwork":
    """The network in a file, the shipped one for None.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it holds no tour network.
        UnsupportedTaskError: if none is shipped.
    """
    # Imported lazily: importing the compiler takes seconds.
    from drone_env.agents.tour_network import load_tour_network

    if network is None and not SHIPPED.is_file():
        raise UnsupportedTaskError(f"no tour network is shipped as {SHIPPED}: name a file, as in tournet:FILE")
    return load_tour_network(SHIPPED if network is None else network)


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
        UnsupportedTaskError: if no network is shipped.
    """

    def __init__(self, task: TaskConfig, network: Path | None = None) -> None:
        from drone_env.agents.tour_encoder import FeatureEncoder  # lazily, as above

        self._network = tour_network(network)
        self._encoder = FeatureEncoder(task)
        self.config: Mapping[str, object] = {"agent": "tournet", "version": 1, "network": self._network.digest}

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The next actions, int64[N]; WAIT if no stop is within reach."""
        return choose(self._encoder, self._network, grids, telemetry)


class TournetSearchAgent(PlannedAgent):
    """Flies the best of K plans: the one that the network prefers, and samples from the network.

    A plan flies each path to its end before it chooses the next, while `tournet` chooses at every step: on some maps
    (21 of 1,000 of skyline_hard with 8 plans) no plan is as good as the flight of `tournet`. Samples depend only on the
    seed of the map. Not thread-safe.

    Args:
        task: The task.
        network: The file of an exported tour network; None for the shipped one.
        plans: K, at least 1.

    Raises:
        InvalidValueError: if `plans` is below 1.
        OSError: if the file cannot be read.
        CheckpointError: if it holds no tour network.
        TooLargeError: if the features of a state would take too much memory.
        UnsupportedTaskError: if no network is shipped.
    """

    def __init__(self, task: TaskConfig, network: Path | None = None, plans: int = 8) -> None:
        super().__init__(task)
        if plans < 1:
            raise InvalidValueError(f"plans must be at least 1, got {plans}")
        from drone_env.agents.tour_plans import TEMPERATURES, TourPlanner  # lazily, as above

        loaded = tour_network(network)
        self._planner = TourPlanner(task, loaded, plans)
        self.config: Mapping[str, object] = {
            "agent": "tournet-search",
            "version": 1,
            "plans": plans,
            "temperatures": list(TEMPERATURES),
            "network": loaded.digest,
        }

    def plan(self, episodes: Sequence[Episode]) -> npt.NDArray[np.int64]:
        """The remaining actions of the best plans over episodes, int64[N, max_steps]."""
        snapshots = [episode.get_state() for episode in episodes]
        grids = np.stack([np.frombuffer(snapshot.grid, np.uint8) for snapshot in snapshots])
        states = np.stack([np.frombuffer(snapshot.numbers, np.uint16) for snapshot in snapshots])
        plans = np.full((len(episodes), self.task.max_steps), Action.WAIT, np.int64)
        for plan, actions, episode in zip(plans, self._planner.best(grids, states, self.seeds), episodes, strict=True):
            plan[: len(actions) - episode.steps] = actions[episode.steps :]
        return plans


def choose(
    encoder: "FeatureEncoder", network: "Network", grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]
) -> npt.NDArray[np.int64]:
    """The first actions of the options that a network prefers, int64[N]; WAIT if there is none.

    Args:
        encoder: The encoder of the task.
        network: The network.
        grids: uint8[N, height, width]
        telemetry: float32[N, telemetry_size]
    """
    parts: list[npt.NDArray[np.int64]] = []
    for i in range(0, len(grids), encoder.most):
        features = encoder(grids[i : i + encoder.most], telemetry[i : i + encoder.most])
        choices, _ = network(features)
        parts.append(first_actions(features, choices))
    return np.concatenate(parts)


def first_actions(features: "Features", choices: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
    """The first action of the best option of each state, int64[M]; WAIT if there is none.

    Args:
        features: The features of M states.
        choices: float32[options], the logits.
    """
    actions = np.full(len(features.begins) - 1, Action.WAIT, np.int64)
    options = best_options(features, choices)
    actions[options >= 0] = features.numbers[options[options >= 0], 2]
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
