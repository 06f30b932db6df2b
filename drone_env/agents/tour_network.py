"""The tour network in NumPy, from an exported file: the same as `rl.models.TourNet`.

It processes the present tokens of all states one after another: P tokens with Q pairs of tokens of one state. NumPy
multiplies the large matrices; attention within the small states is compiled.
"""

from pathlib import Path
from typing import Any

import numpy as np

from drone_env.agents.pathqnet import EPSILON
from drone_env.agents.tour_features import EDGE_FEATURES, OPTION_FEATURES, TOKEN_FEATURES, Features
from drone_env.agents.weights_file import TOURNET, Array, Weights, in_one_thread, read_weights
from drone_env.core.compile_cache import compiled_once

WIDTH, HEADS, LAYERS, EDGE, EDGE_HIDDEN, HIDDEN = 64, 4, 4, 16, 32, 64
HEAD = WIDTH // HEADS


LAYER_SHAPES: dict[str, tuple[int, ...]] = {
    "tokens": (WIDTH, TOKEN_FEATURES),
    "edges1": (EDGE_HIDDEN, EDGE_FEATURES),
    "edges2": (EDGE, EDGE_HIDDEN),
    "node": (HIDDEN, WIDTH),
    "option": (HIDDEN, OPTION_FEATURES),  # without a bias
    "hidden": (HIDDEN, HIDDEN),
    "head": (2, HIDDEN),
    "norm": (WIDTH,),
}
BLOCK_SHAPES: dict[str, tuple[int, ...]] = {
    "norm1": (WIDTH,),
    "qkv": (3 * WIDTH, WIDTH),
    "bias": (HEADS, EDGE),
    "out": (WIDTH, WIDTH + HEADS * EDGE),
    "norm2": (WIDTH,),
    "up": (2 * WIDTH, WIDTH),
    "down": (WIDTH, 2 * WIDTH),
}
LAYER_SHAPES.update({f"blocks.{i}.{name}": shape for i in range(LAYERS) for name, shape in BLOCK_SHAPES.items()})
SHAPES: dict[str, tuple[int, ...]] = {f"{name}.weight": shape for name, shape in LAYER_SHAPES.items()}
SHAPES.update({f"{name}.bias": shape[:1] for name, shape in LAYER_SHAPES.items() if name != "option"})
"""The shapes of the parameters, under the names of `rl.models`."""


@compiled_once(nogil=True, error_model="numpy", fastmath=True)
def normalise(x: Any, weight: Any, bias: Any, normal: Any) -> None:
    """Write PyTorch's LayerNorm of each row to `normal`. All float32, [P, width] and [width]."""
    width = x.shape[1]
    scale = np.float32(1.0 / width)
    for p in range(len(x)):
        total = np.float32(0.0)
        for f in range(width):
            total += x[p, f]
        mean = total * scale
        total = np.float32(0.0)
        for f in range(width):
            total += (x[p, f] - mean) * (x[p, f] - mean)
        by = np.float32(1.0) / np.sqrt(total * scale + np.float32(EPSILON))
        for f in range(width):
            normal[p, f] = (x[p, f] - mean) * by * weight[f] + bias[f]


@compiled_once(nogil=True, error_model="numpy", fastmath=True)
def match(qkv: Any, biases: Any, layer: int, counts: Any, weights: Any) -> None:
    """Write the attention logits of each token to the others of its state, at most 0.

    Args:
        qkv: float32[P, 3 * width], queries, keys and values.
        biases: float32[Q, layers * heads], what the edges add.
        layer: The number of the layer.
        counts: int64[M], the number of tokens of each state.
        weights: float32[heads * Q], the output: for each token and head, one for each token of the state.
    """
    scale = np.float32(1.0 / np.sqrt(HEAD))
    token, pair, at = 0, 0, 0
    for n in counts:
        for s in range(token, token + n):
            for h in range(HEADS):
                most = np.float32(-np.inf)
                for t in range(n):
                    total = np.float32(0.0)
                    for f in range(h * HEAD, h * HEAD + HEAD):
                        total += qkv[s, f] * qkv[token + t, WIDTH + f]
                    total = total * scale + biases[pair + t, layer * HEADS + h]
                    weights[at + t] = total
                    most = max(most, total)
                for t in range(n):
                    weights[at + t] -= most
                at += n
            pair += n
        token += n


@compiled_once(nogil=True, error_model="numpy", fastmath=True)
def gather(qkv: Any, edges: Any, counts: Any, weights: Any, messages: Any) -> None:
    """Write the means of values and edges by the attention of each token.

    Args:
        qkv: float32[P, 3 * width], queries, keys and values.
        edges: float32[Q, edge]
        counts: int64[M], the number of tokens of each state.
        weights: float32[heads * Q], as `match` lays them out, above 0.
        messages: float32[P, width + heads * edge], the output.
    """
    token, pair, at = 0, 0, 0
    for n in counts:
        for s in range(token, token + n):
            for h in range(HEADS):
                total = np.float32(0.0)
                for f in range(HEAD):
                    messages[s, h * HEAD + f] = 0.0
                for f in range(EDGE):
                    messages[s, WIDTH + h * EDGE + f] = 0.0
                for t in range(n):
                    weight = weights[at + t]
                    total += weight
                    for f in range(HEAD):
                        messages[s, h * HEAD + f] += weight * qkv[token + t, 2 * WIDTH + h * HEAD + f]
                    for f in range(EDGE):
                        messages[s, WIDTH + h * EDGE + f] += weight * edges[pair + t, f]
                share = np.float32(1.0) / total
                for f in range(HEAD):
                    messages[s, h * HEAD + f] *= share
                for f in range(EDGE):
                    messages[s, WIDTH + h * EDGE + f] *= share
                at += n
            pair += n
        token += n


class TourNetwork:
    """The logits of the options of M states, and of whether the mission can be completed after each.

    Args:
        weights: The content of an exported file.
    """

    def __init__(self, weights: Weights) -> None:
        self.parameters, self.metadata, self.digest = weights
        p = self.parameters
        # Transposed once, for products from the right.
        self._layers = {
            name.removesuffix(".weight"): np.ascontiguousarray(array.T)
            for name, array in p.items()
            if array.ndim == 2 and ".bias." not in name
        }
        weight = np.concatenate([p[f"blocks.{i}.bias.weight"] for i in range(LAYERS)])
        self._bias_weights = np.ascontiguousarray(weight.T)
        self._biases = np.concatenate([p[f"blocks.{i}.bias.bias"] for i in range(LAYERS)])

    @in_one_thread
    def __call__(self, features: Features) -> tuple[Array, Array]:
        """Choice and completion, float32[options] each."""
        there = features.present
        edges = features.edges[there[:, :, None] & there[:, None, :]]
        edges = _rectified(self._linear("edges2", _rectified(self._linear("edges1", edges))))
        biases = edges @ self._bias_weights + self._biases
        x = self._linear("tokens", features.tokens[there])
        counts = there.sum(axis=1)
        normal, weights = np.empty_like(x), np.empty(HEADS * len(edges), np.float32)
        messages = np.empty((len(x), WIDTH + HEADS * EDGE), np.float32)
        for i in range(LAYERS):
            block = f"blocks.{i}"
            self._normalise(f"{block}.norm1", x, normal)
            qkv = self._linear(f"{block}.qkv", normal)
            match(qkv, biases, i, counts, weights)
            gather(qkv, edges, counts, np.exp(weights, out=weights), messages)
            x += self._linear(f"{block}.out", messages)
            self._normalise(f"{block}.norm2", x, normal)
            x += self._linear(f"{block}.down", _rectified(self._linear(f"{block}.up", normal)))
        self._normalise("norm", x, normal)
        nodes = self._linear("node", normal)
        row = there.ravel().cumsum().reshape(there.shape) - 1
        owner = np.repeat(np.arange(len(there)), np.diff(features.begins))
        y = _rectified(nodes[row[owner, features.token]] + features.options @ self._layers["option"])
        y += _rectified(self._linear("hidden", y))
        choice, completion = self._linear("head", y).T
        return choice - 2 * np.logaddexp(0, -completion), completion

    def _linear(self, name: str, x: Array) -> Array:
        y = x @ self._layers[name]
        y += self.parameters[f"{name}.bias"]
        return y

    def _normalise(self, name: str, x: Array, normal: Array) -> None:
        normalise(x, self.parameters[f"{name}.weight"], self.parameters[f"{name}.bias"], normal)


def _rectified(x: Array) -> Array:
    """ReLU, in place."""
    return np.maximum(x, 0, out=x)


def load_tour_network(path: Path) -> TourNetwork:
    """Read an exported network.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it is not an exported tour network; the message says why.
    """
    return TourNetwork(read_weights(path, TOURNET, lambda metadata: SHAPES))
