"""PathQNet without PyTorch: the same network in NumPy, from an exported file.

The file is NumPy's `.npz`: one array per parameter, under PyTorch's names, and `metadata`, JSON text. A single map
takes some hundred microseconds, and no inference library has to be installed.
"""

import hashlib
import json
import math
import stat
import struct
import tokenize
import zlib
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, cast
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile

import numpy as np
import numpy.typing as npt

from drone_env.core.actions import N_ACTIONS
from drone_env.core.cells import N_CELL_KINDS
from drone_env.errors import CheckpointError

POOLED = 4
EPSILON = 1e-5
"""What PyTorch's LayerNorm adds to the variance."""
Array = npt.NDArray[np.float32]
MAP_FEATURES = 64
SHAPES: dict[str, tuple[int, ...]] = {
    "encoder.embedding.weight": (N_CELL_KINDS, 8),
    "encoder.conv1.weight": (16, 8, 3, 3),
    "encoder.conv2.weight": (32, 16, 3, 3),
    "encoder.linear.weight": (MAP_FEATURES, 32 * POOLED * POOLED),
    "head.0.weight": (128, MAP_FEATURES),  # and a column for each value of the telemetry
    "head.1.weight": (128,),
    "head.3.weight": (128, 128),
    "head.5.weight": (64, 128),
    "head.7.weight": (N_ACTIONS, 64),
}
SHAPES.update(
    {name.replace("weight", "bias"): shape[:1] for name, shape in SHAPES.items() if name != "encoder.embedding.weight"}
)
"""The parameters of a network, here and in `rl.model`; a layer has a bias for each of its outputs."""
MOST_BYTES = 1 << 20
"""More than three times what a network takes, packed or not. No more than that is ever read or unpacked."""
LARGEST = 100.0
"""No parameter lies beyond it: those that were trained stay below 3, and up to it no value can overflow."""
UNREADABLE = (ValueError, TypeError, BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError,
              RecursionError, MemoryError, OverflowError, SyntaxError, tokenize.TokenError)  # fmt: skip
"""What is raised over a malformed archive, array or JSON. Sizes are checked before, so memory is that of the parser."""


class Network:
    """The values of the five actions: float32[B, 5] from grids uint8[B, H, W] and telemetry float32[B, telemetry_size].

    Args:
        parameters: The arrays of the exported file.
        metadata: What the file says about its making; `telemetry_size` is among it.
        digest: First 16 digits of the SHA-256 of the file.
    """

    def __init__(self, parameters: dict[str, Array], metadata: dict[str, Any], digest: str) -> None:
        self.metadata = metadata
        self.digest = digest
        self.parameters = parameters
        embedding, weight = parameters["encoder.embedding.weight"], parameters["encoder.conv1.weight"]
        # The first convolution only ever sees embeddings, so it is nine table lookups. The last row is the padding.
        table = np.einsum("ke,oeyx->yxko", embedding, weight).reshape(9, len(embedding), -1)
        self._conv1 = np.concatenate([table, np.zeros_like(table[:, :1])], axis=1)
        self._conv2 = parameters["encoder.conv2.weight"].transpose(2, 3, 1, 0).reshape(-1, weight.shape[0] * 2)

    def __call__(self, grids: npt.NDArray[np.uint8], telemetry: Array) -> Array:
        """The values of the actions."""
        p = self.parameters
        x = np.concatenate([self._encode(grids), telemetry], axis=1)
        x = x @ p["head.0.weight"].T + p["head.0.bias"]
        centred = x - x.mean(axis=1, keepdims=True)
        x = centred / np.sqrt(np.mean(centred**2, axis=1, keepdims=True) + EPSILON)
        x = np.maximum(x * p["head.1.weight"] + p["head.1.bias"], 0)
        x = np.maximum(x @ p["head.3.weight"].T + p["head.3.bias"], 0)
        x = np.maximum(x @ p["head.5.weight"].T + p["head.5.bias"], 0)
        return x @ p["head.7.weight"].T + p["head.7.bias"]

    def _encode(self, grids: npt.NDArray[np.uint8]) -> Array:
        p = self.parameters
        n, height, width = grids.shape
        padded = np.pad(grids, ((0, 0), (1, 1), (1, 1)), constant_values=N_CELL_KINDS)
        x = np.broadcast_to(p["encoder.conv1.bias"], (n, height, width, self._conv1.shape[2])).copy()
        for i in range(9):
            x += self._conv1[i][padded[:, i // 3 : i // 3 + height, i % 3 : i % 3 + width]]
        x = np.pad(np.maximum(x, 0), ((0, 0), (1, 1), (1, 1), (0, 0)))
        patches = [x[:, i // 3 : i // 3 + height, i % 3 : i % 3 + width] for i in range(9)]
        x = np.maximum(np.concatenate(patches, axis=3) @ self._conv2 + p["encoder.conv2.bias"], 0)
        x = np.einsum("ph,nhwc,qw->npqc", pooling(height), x, pooling(width), optimize=True)
        return np.maximum(x.reshape(n, -1) @ p["encoder.linear.weight"].T + p["encoder.linear.bias"], 0)


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
    """Read an exported network. Whatever the file says of itself, no more than `MOST_BYTES` are unpacked.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it is not an exported network; the message says why.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise ValueError("it is no file")
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        return Network(*_unpacked(content), hashlib.sha256(content).hexdigest()[:16])
    except UNREADABLE as error:
        why = str(error) or type(error).__name__
        raise CheckpointError(f"{path} is not an exported network (.npz, beside the checkpoint): {why}") from None


def _unpacked(content: bytes) -> tuple[dict[str, Array], dict[str, Any]]:
    """Parameters and metadata of a file.

    Raises:
        UNREADABLE: if it is not an exported network.
    """
    if len(content) > MOST_BYTES:
        raise ValueError(f"it has more than {MOST_BYTES} bytes")
    with ZipFile(BytesIO(content)) as archive:
        entries = archive.infolist()
        if sorted(entry.filename for entry in entries) != sorted(f"{name}.npy" for name in (*SHAPES, "metadata")):
            raise ValueError("it does not hold the parameters of a network and its metadata, and nothing else")
        declared = sum(entry.file_size for entry in entries)
        if declared > MOST_BYTES:
            raise ValueError(f"unpacked it would have {declared} bytes, and a network has at most {MOST_BYTES}")
        arrays: dict[str, npt.NDArray[Any]] = {}
        for entry in entries:
            if entry.flag_bits & 1 or entry.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
                raise ValueError(f"{entry.filename} is encrypted, or packed in a way that NumPy does not write")
            with archive.open(entry) as opened:
                # Bounded: unpacked without a number, an entry that lies about its size would be unpacked whole.
                arrays[entry.filename.removesuffix(".npy")] = _array(opened.read(entry.file_size + 1))
    metadata = _metadata(arrays.pop("metadata"))
    for name, array in arrays.items():
        rows, *rest = SHAPES[name]
        shape = (rows, *rest) if name != "head.0.weight" else (rows, MAP_FEATURES + metadata["telemetry_size"])
        if array.dtype != np.float32 or array.shape != shape:
            raise ValueError(f"{name} is {array.dtype}{list(array.shape)} instead of float32{list(shape)}")
        if not (np.abs(array) <= LARGEST).all():
            raise ValueError(f"{name} has values that are no numbers, or beyond {LARGEST:g}")
    return arrays, metadata


def _array(content: bytes) -> npt.NDArray[Any]:
    """The array in an entry. NumPy's own reader makes room for as many values as the header claims."""
    file = BytesIO(content)
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise ValueError(f"it has arrays of version {version}, and networks are written with those of (1, 0)")
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(file)
    values = np.frombuffer(content[file.tell() :], dtype)
    if values.shape != (math.prod(shape),):
        raise ValueError(f"an array of {list(shape)} values has {len(values)}")
    return values.reshape(shape, order="F" if by_columns else "C").copy()


def _metadata(array: npt.NDArray[Any]) -> dict[str, Any]:
    if array.shape != () or array.dtype.kind != "U":
        raise ValueError("its metadata are no text")
    metadata = json.loads(str(array))
    if not isinstance(metadata, dict):
        raise ValueError("its metadata are no JSON object")
    metadata = cast(dict[str, Any], metadata)
    telemetry_size = metadata.get("telemetry_size")
    if type(telemetry_size) is not int or not 0 < telemetry_size <= MAP_FEATURES:
        raise ValueError("its metadata do not say telemetry_size, the number of values that it takes beside the map")
    return metadata
