"""Files of networks, and how they are read safely.

A file is NumPy's `.npz`: one array per parameter, under PyTorch's names, and `metadata`, JSON text. Its entry `network`
says whose the parameters are; where it is missing they are PathQNet's.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from drone_env.errors import CheckpointError, shown
from drone_env.files import read_file
from drone_env.npz import unpack_arrays

WEIGHTS = Path(__file__).parents[1] / "weights"
"""Where the networks lie that are shipped."""
Array = npt.NDArray[np.float32]
Arrays = dict[str, npt.NDArray[Any]]
Shapes = Mapping[str, tuple[int, ...]]
"""The shape of each parameter of a network, by its name."""
PATHQNET, TOURNET = "pathqnet", "tournet"
"""The networks. A file that names none is of the first."""
METADATA = "metadata"
NOT_WHOLE = "it does not hold the parameters of a network and its metadata, and nothing else"
MOST_BYTES = 1 << 20
"""More than any network takes, packed or not. No more than that is ever read or unpacked."""
LARGEST = 100.0
"""No parameter lies beyond it: those that were trained stay below 3, and up to it no value can overflow."""


class Weights(NamedTuple):
    """What a file of a network holds."""

    parameters: dict[str, Array]
    metadata: dict[str, Any]
    """What it says about its making."""
    digest: str
    """First 16 digits of the SHA-256 of the file."""


def read_weights(path: Path, network: str, shapes_of: Callable[[dict[str, Any]], Shapes]) -> Weights:
    """Read the file of a network. Whatever it says of itself, no more than `MOST_BYTES` are unpacked.

    Args:
        path: The file.
        network: Whose parameters they must be.
        shapes_of: What they must look like, by the metadata; raises ValueError where these lack something.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it is not such a file; the message says why.
    """
    arrays, metadata, digest = _read(path)
    try:
        found = metadata.get("network", PATHQNET)
        if found != network:
            raise ValueError(f"it holds a network of {shown(found)}, not of {network!r}")
        parameters = _parameters(arrays, shapes_of(metadata))
    except (ValueError, TypeError) as error:
        raise _refused(path, error) from None
    return Weights(parameters, metadata, digest)


def network_of(path: Path) -> str:
    """Whose parameters a file holds, by its metadata.

    Raises:
        OSError: if it cannot be read.
        CheckpointError: if it is no file of a network.
    """
    return str(_read(path)[1].get("network", PATHQNET))


def _read(path: Path) -> tuple[Arrays, dict[str, Any], str]:
    """The parameters, the metadata and the digest of a file."""
    try:
        content = read_file(path, MOST_BYTES)
        arrays = unpack_arrays(content, MOST_BYTES)
        metadata = _metadata(arrays.pop(METADATA, None))
    except (ValueError, RecursionError) as error:
        raise _refused(path, error) from None
    return arrays, metadata, hashlib.sha256(content).hexdigest()[:16]


def _refused(path: Path, error: Exception) -> CheckpointError:
    why = str(error).removeprefix(f"{path} ")
    return CheckpointError(f"{path} is not an exported network (.npz, beside the checkpoint): {why}")


def _parameters(arrays: Arrays, shapes: Shapes) -> dict[str, Array]:
    """The parameters in an archive, if they are those of a network: by name, type, shape and size."""
    if arrays.keys() != shapes.keys():
        raise ValueError(NOT_WHOLE)
    for name, shape in shapes.items():
        array = arrays[name]
        if array.dtype != np.float32 or array.shape != shape:
            raise ValueError(f"{name} is {array.dtype}{list(array.shape)} instead of float32{list(shape)}")
        if not (np.abs(array) <= LARGEST).all():
            raise ValueError(f"{name} has values that are no numbers, or beyond {LARGEST:g}")
    return arrays


def _metadata(array: npt.NDArray[Any] | None) -> dict[str, Any]:
    if array is None:
        raise ValueError(NOT_WHOLE)
    if array.shape != () or array.dtype.kind != "U":
        raise ValueError("its metadata are no text")
    metadata = json.loads(str(array))
    if not isinstance(metadata, dict):
        raise ValueError("its metadata are no JSON object")
    return cast(dict[str, Any], metadata)
