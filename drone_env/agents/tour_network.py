"""The tour network in NumPy, from an exported file: the same as `rl.model.TourNet`."""

from math import sqrt
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drone_env.agents.tour_features import Features, make_features
from drone_env.agents.weights_file import TOURNET, Array, NumpyNetwork, in_one_thread, read_weights, rejecting

WIDTH, HEADS, LAYERS, EDGE, EDGE_HIDDEN, HIDDEN = 64, 4, 4, 16, 32, 64
HEAD = WIDTH // HEADS


class TourNetwork(NumpyNetwork):
    """The logits of the options of M states, and of whether each loses no parcel.

    Args:
        weights: The content of an exported file.
    """

    @in_one_thread
    def __call__(self, features: Features) -> tuple[Array, Array]:
        """Choice and completion, float32[options] each."""
        x = self._layer("tokens", features.tokens)
        edges = relu(self._layer("edges2", relu(self._layer("edges1", features.edges))))
        for i in range(LAYERS):
            x = self._block(f"blocks.{i}", x, edges, features.present)
        nodes = self._layer("node", self._normalise("norm", x))
        owner = np.repeat(np.arange(len(nodes)), np.diff(features.begins))
        y = relu(nodes[owner, features.token] + features.options @ self.parameters["option.weight"].T)
        y += relu(self._layer("hidden", y))
        choice, completion = self._layer("head", y).T
        return choice - 2 * np.logaddexp(0, -completion), completion

    def _block(self, name: str, x: Array, edges: Array, present: npt.NDArray[np.bool_]) -> Array:
        """Attention between the present tokens of each state, then a layer for each token, float32[M, N, width]."""
        m, n, _ = x.shape
        qkv = self._layer(f"{name}.qkv", self._normalise(f"{name}.norm1", x))
        q, k, v = qkv.reshape(m, n, 3, HEADS, HEAD).transpose(2, 0, 3, 1, 4)
        logits = q @ k.swapaxes(2, 3) / sqrt(HEAD) + self._layer(f"{name}.bias", edges).transpose(0, 3, 1, 2)
        logits = np.where(present[:, None, None, :], logits, -np.inf)
        weights = np.exp(logits - logits.max(axis=3, keepdims=True))
        weights /= weights.sum(axis=3, keepdims=True)
        values = (weights @ v).transpose(0, 2, 1, 3).reshape(m, n, WIDTH)
        messages = (weights.transpose(0, 2, 1, 3) @ edges).reshape(m, n, HEADS * EDGE)
        x = x + self._layer(f"{name}.out", np.concatenate([values, messages], axis=2))
        return x + self._layer(f"{name}.down", relu(self._layer(f"{name}.up", self._normalise(f"{name}.norm2", x))))


def relu(x: Array) -> Array:
    """ReLU, in place."""
    return np.maximum(x, 0, out=x)


def load_tour_network(path: Path) -> TourNetwork:
    """Read an exported network.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it is not an exported network.
    """
    network, features = TourNetwork(read_weights(path, TOURNET)), make_features(1, 1, 1)
    features.present[:], features.begins[1] = True, 1
    with rejecting(path):  # one call shows whether the parameters fit
        network(features)
    return network
