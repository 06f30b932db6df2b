"""Files of networks. They may come from anybody, so everything in them is checked.

A file is in the safetensors format: float32 parameters under PyTorch's names and, in the metadata, a JSON object as the
entry `drone_env`. The object's entry `network` names the network, PathQNet if it is missing.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load, save
from threadpoolctl import ThreadpoolController

from drone_env.errors import CheckpointError, abbreviate
from drone_env.files import read_file, replacing

WEIGHTS = Path(__file__).parents[1] / "weights"
"""The folder of the shipped networks."""
Array = npt.NDArray[np.float32]
Shapes = Mapping[str, tuple[int, ...]]
"""The shape of each parameter of a network, by its name."""
PATHQNET, TOURNET = "pathqnet", "tournet"
"""The networks."""
METADATA = "drone_env"
MOST_BYTES = 1 << 20
"""Maximum size of a file."""
LARGEST = 100.0
"""Maximum absolute value of a parameter: trained ones stay below 3, and up to it nothing overflows."""
in_one_thread = ThreadpoolController().wrap(limits=1, user_api="blas")
"""Decorator: NumPy multiplies matrices in the calling thread. The matrices are small: on a busy machine, threads of the
BLAS library would take several times as long."""


class Weights(NamedTuple):
    """The content of a network's file."""

    parameters: dict[str, Array]
    metadata: dict[str, Any]
    digest: str
    """First 16 digits of the file's SHA-256."""


def write_weights(path: Path, parameters: Mapping[str, Array], metadata: Mapping[str, Any]) -> None:
    """Write a network to a file, and create missing folders."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = save(dict(parameters), {METADATA: json.dumps(metadata, sort_keys=True)})
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def read_weights(path: Path, network: str, shapes_of: Callable[[dict[str, Any]], Shapes]) -> Weights:
    """Read the file of a network.

    Args:
        path: The file.
        network: The expected network.
        shapes_of: Returns the expected shapes, by the metadata; raises ValueError if these are incomplete.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it is not such a file.
    """
    weights = _read(path)
    try:
        found = weights.metadata.get("network", PATHQNET)
        if found != network:
            raise ValueError(f"it contains a network of {abbreviate(found)}, not of {network!r}")
        _require_shapes(weights.parameters, shapes_of(weights.metadata))
    except (ValueError, TypeError) as error:
        raise _rejected(path, error) from None
    return weights


def network_of(path: Path) -> str:
    """The network that a file names in its metadata."""
    return str(_read(path).metadata.get("network", PATHQNET))


def _read(path: Path) -> Weights:
    try:
        content = read_file(path, MOST_BYTES)
        parameters = load(content)
        header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
        metadata = json.loads(header["__metadata__"][METADATA])
        if not isinstance(metadata, dict):
            raise ValueError("its metadata is not a JSON object")
    except KeyError as error:
        raise _rejected(path, ValueError(f"it lacks {error}")) from None
    except (SafetensorError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise _rejected(path, error) from None
    return Weights(parameters, cast(dict[str, Any], metadata), hashlib.sha256(content).hexdigest()[:16])


def _rejected(path: Path, error: Exception) -> CheckpointError:
    reason = str(error).removeprefix(f"{path} ")
    return CheckpointError(f"{path} is not an exported network (.safetensors, beside the checkpoint): {reason}")


def _require_shapes(parameters: Mapping[str, npt.NDArray[Any]], shapes: Shapes) -> None:
    if parameters.keys() != shapes.keys():
        raise ValueError("its parameters are not those of the network")
    for name, shape in shapes.items():
        array = parameters[name]
        if array.dtype != np.float32 or array.shape != shape:
            raise ValueError(f"{name} is {array.dtype}{list(array.shape)} instead of float32{list(shape)}")
        if not (np.abs(array) <= LARGEST).all():
            raise ValueError(f"{name} has NaN, or values beyond {LARGEST:g}")
