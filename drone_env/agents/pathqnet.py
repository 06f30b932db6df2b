"""The agent that a trained network flies: always the action of the highest value."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drone_env.agents.network import load_network
from drone_env.agents.weights_file import WEIGHTS
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import CheckpointError, UnsupportedTaskError


def shipped_network(task: TaskConfig) -> Path:
    """Where the network of a task lies, if one is shipped."""
    return WEIGHTS / f"{task.id}_v{task.version}.npz"


class PathQNetAgent:
    """Flies by a network.

    Args:
        task: The task.
        network: The file of an exported network; training writes one beside each checkpoint. None for the network
            that is shipped with the task.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it holds no network, or one that takes other telemetry than the task has.
        UnsupportedTaskError: if no network is shipped with the task.
    """

    stateless = True

    def __init__(self, task: TaskConfig, network: Path | None = None) -> None:
        path = shipped_network(task) if network is None else network
        if network is None and not path.is_file():
            raise UnsupportedTaskError(
                f"no network is shipped for {task.id!r}: train one (drone-env train --task {task.short_name}) and name "
                f"its file with --checkpoint (data/{task.short_name}.npz)"
            )
        self._network = load_network(path)
        takes = self._network.metadata["telemetry_size"]
        if takes != task.telemetry_size:
            raise CheckpointError(
                f"{path} takes {takes} values of telemetry, and {task.id!r} has {task.telemetry_size}"
            )
        self.config: Mapping[str, object] = {"agent": "pathqnet", "version": 1, "network": self._network.digest}

    def reset(self, seed: int) -> None:
        """Nothing to forget."""

    def q_values(self, observation: Observation) -> npt.NDArray[np.float32]:
        """The network's values of the actions, float32[5]."""
        return self._network(observation["grid"][None], observation["telemetry"][None])[0]

    def act(self, observation: Observation) -> int:
        """The action of the highest value."""
        return int(self.q_values(observation).argmax())

    def reset_batch(self, seeds: npt.NDArray[np.int64]) -> None:
        """Nothing to forget."""

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The actions of the highest values, int64[N]."""
        parts = range(0, len(grids), CHUNK)
        return np.concatenate(
            [self._network(grids[i : i + CHUNK], telemetry[i : i + CHUNK]).argmax(axis=1) for i in parts]
        )


CHUNK = 256
"""Maps at a time, so that what is worked on stays in the cache."""
