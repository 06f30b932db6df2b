"""PathQNet in NumPy, from an exported file, and its agent."""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drone_env.agents.base import StatelessAgent
from drone_env.agents.weights_file import PATHQNET, WEIGHTS, Array, NumpyNetwork, in_one_thread, read_weights, rejecting
from drone_env.core.episode import Observation
from drone_env.core.tasks import TaskConfig
from drone_env.errors import UnsupportedTaskError

POOLED = 4
MAP_FEATURES = 64


class Network(NumpyNetwork):
    """The values of the five actions: float32[B, 5] from grids uint8[B, H, W] and telemetry float32[B, telemetry_size].

    A single map takes some hundred microseconds.

    Args:
        weights: The content of an exported file; its metadata contain `telemetry_size`.
    """

    @in_one_thread
    def __call__(self, grids: npt.NDArray[np.uint8], telemetry: Array) -> Array:
        """The values of the actions."""
        x = np.concatenate([self._encode(grids), telemetry], axis=1)
        x = np.maximum(self._normalise("head.1", self._layer("head.0", x)), 0)
        x = np.maximum(self._layer("head.3", x), 0)
        x = np.maximum(self._layer("head.5", x), 0)
        return self._layer("head.7", x)

    def _encode(self, grids: npt.NDArray[np.uint8]) -> Array:
        """The map features, float32[B, 64]."""
        x = self.parameters["encoder.embedding.weight"][grids]
        x = self._convolve("encoder.conv2", self._convolve("encoder.conv1", x))
        n, height, width, _ = x.shape
        x = np.einsum("ph,nhwc,qw->npqc", pooling(height), x, pooling(width), optimize=True)
        return np.maximum(self._layer("encoder.linear", x.reshape(n, -1)), 0)

    def _convolve(self, name: str, x: Array) -> Array:
        """A 3 x 3 convolution with padding, then ReLU: float32[B, H, W, outputs] from float32[B, H, W, inputs]."""
        _, height, width, _ = x.shape
        padded = np.pad(x, ((0, 0), (1, 1), (1, 1), (0, 0)))
        patches = [padded[:, i // 3 : i // 3 + height, i % 3 : i % 3 + width] for i in range(9)]
        weight = self.parameters[f"{name}.weight"]
        flat = weight.transpose(2, 3, 1, 0).reshape(-1, len(weight))
        return np.maximum(np.concatenate(patches, axis=3) @ flat + self.parameters[f"{name}.bias"], 0)


@lru_cache(maxsize=16)
def pooling(size: int) -> Array:
    """Adaptive average pooling along one side as a matrix, float32[4, size].

    Part i is the mean of the cells from floor(i * size / 4) up to ceil((i + 1) * size / 4).
    """
    matrix = np.zeros((POOLED, size), np.float32)
    for i in range(POOLED):
        start, stop = i * size // POOLED, -(-(i + 1) * size // POOLED)
        matrix[i, start:stop] = 1 / (stop - start)
    return matrix


def load_network(path: Path) -> Network:
    """Read an exported network.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it is not an exported network.
    """
    network = Network(read_weights(path, PATHQNET))
    with rejecting(path):  # one call shows whether the parameters fit
        network(np.zeros((1, POOLED, POOLED), np.uint8), np.zeros((1, network.metadata["telemetry_size"]), np.float32))
    return network


MAPS_AT_ONCE = 256
"""Maximum number of maps per call of the network: their arrays fit into the processor's cache."""


def shipped_network(task: TaskConfig, network: str = PATHQNET) -> Path:
    """Path of a task's shipped network, PathQNet or `ppo`; the file may be missing."""
    return WEIGHTS / f"{'' if network == PATHQNET else f'{network}_'}{task.id}_v{task.version}.safetensors"


def require_shipped(task: TaskConfig, network: str = PATHQNET) -> Path:
    """Path of a task's shipped network.

    Raises:
        UnsupportedTaskError: if none is shipped with the task.
    """
    path, algorithm = shipped_network(task, network), "" if network == PATHQNET else f" --algorithm {network}"
    if not path.is_file():
        raise UnsupportedTaskError(
            f"no network is shipped for {task.id!r}: name the file of one, as in {network}:FILE, "
            f"or train one first (drone-env train{algorithm} --task {task.short_name})"
        )
    return path


class PathQNetAgent(StatelessAgent):
    """Takes the action with the highest value.

    Args:
        task: The task.
        network: The file of an exported network; None for the shipped one.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it is no network, or takes other telemetry than the task has.
        UnsupportedTaskError: if no network is shipped with the task.
    """

    def __init__(self, task: TaskConfig, network: Path | None = None) -> None:
        path = network or require_shipped(task)
        self._network = load_network(path)
        self._network.check_telemetry(path, task)
        self.config: Mapping[str, object] = {"agent": "pathqnet", "version": 1, "network": self._network.digest}

    def q_values(self, observation: Observation) -> npt.NDArray[np.float32]:
        """The values of the actions, float32[5]."""
        return self._network(observation["grid"][None], observation["telemetry"][None])[0]

    def act_batch(self, grids: npt.NDArray[np.uint8], telemetry: npt.NDArray[np.float32]) -> npt.NDArray[np.int64]:
        """The actions with the highest values, int64[N]."""
        chunks = range(0, len(grids), MAPS_AT_ONCE)
        return np.concatenate(
            [self._network(grids[i : i + MAPS_AT_ONCE], telemetry[i : i + MAPS_AT_ONCE]).argmax(axis=1) for i in chunks]
        )
