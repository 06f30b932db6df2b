"""The network of PPO in NumPy, from an exported file, and its agent."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import StatelessAgent
from drone_env.agents.pathqnet import require_shipped
from drone_env.agents.weights_file import PPO, Array, NumpyNetwork, in_one_thread, read_weights, rejecting
from drone_env.core.tasks import TaskConfig


class ActorNetwork(NumpyNetwork):
    """The logits of the five actions, float32[N, 5]: the same as `rl.model.ActorCritic` without the values.

    Args:
        weights: The content of an exported file; its metadata contain `telemetry_size` and the settings.
    """

    shield = rush = False
    """The settings of the training."""

    @in_one_thread
    def __call__(self, entries: npt.NDArray[np.int32], features: Array) -> Array:
        """The logits, from entries int32[N, L] and features float32[N, n] of `envs.forms.StopEntries`."""
        p = self.parameters
        x = p["stops.weight"][entries].sum(axis=1) + features @ p["features.weight"].T + p["features.bias"]
        x = np.maximum(self._layer("hidden", np.maximum(x, 0)), 0)
        return self._layer("actor", x)


def load_actor(path: Path) -> ActorNetwork:
    """Read an exported network.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it is not an exported network.
    """
    # Imported lazily: Gymnasium takes a while, and so does compiling.
    from drone_env.envs.forms import DIRECTION_FEATURES
    from drone_env.planning.nearby import ALL_ENTRIES, ENTRIES

    network = ActorNetwork(read_weights(path, PPO))
    with rejecting(path):  # one call shows whether the parameters fit
        config = network.metadata["config"]
        network.shield, network.rush = bool(config["shield"]), bool(config.get("rush"))
        features = np.zeros((1, network.metadata["telemetry_size"] + DIRECTION_FEATURES), np.float32)
        network(np.array([[(ALL_ENTRIES if network.rush else ENTRIES) - 1]], np.int32), features)
    return network


class PpoAgent(StatelessAgent):
    """Takes the likeliest of the actions that its training chose from.

    Args:
        task: The task.
        network: The file of an exported network; None for the shipped one.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it is no network, or takes other telemetry than the task has.
        UnsupportedTaskError: if no network is shipped with the task.
    """

    def __init__(self, task: TaskConfig, network: Path | None = None) -> None:
        # Imported lazily, because Gymnasium takes a while.
        from drone_env.envs.forms import StopEntries

        path = network or require_shipped(task, PPO)
        self._network = load_actor(path)
        self._network.check_telemetry(path, task)
        self._look = StopEntries(task, self._network.rush)
        self.config: Mapping[str, object] = {"agent": "ppo", "version": 1, "network": self._network.digest}

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The likeliest actions, int64[N]."""
        from drone_env.planning.nearby import choices

        seen = self._look({"grid": grids, "telemetry": telemetry})
        logits = self._network(seen["entries"], seen["features"])
        masks = choices(seen["entries"], telemetry[:, 2] == 1, self._network.shield, self._network.rush)
        return np.where(masks, logits, -np.inf).argmax(axis=1)
