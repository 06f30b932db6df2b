"""Files of networks.

A file is in the safetensors format: parameters under PyTorch's names and, in the metadata, a JSON object as the entry
`drone_env`. The object's entry `network` names the network, PathQNet if it is missing. Parameters are float32, or
float16 if that is exact.
"""

import hashlib
import json
import re
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt
from safetensors.numpy import load, save
from threadpoolctl import ThreadpoolController

from drone_env.core.tasks import TaskConfig
from drone_env.errors import CheckpointError, abbreviate, needs
from drone_env.files import read_file, replacing

WEIGHTS = Path(__file__).parents[1] / "weights"
"""The folder of the shipped networks."""
Array = npt.NDArray[np.float32]
PATHQNET, TOURNET, PPO = "pathqnet", "tournet", "ppo"
"""The networks."""
METADATA = "drone_env"
EPSILON = 1e-5
"""What PyTorch's LayerNorm adds to the variance."""
HUB_FILE = "model.safetensors"
"""The file of a network on the Hub."""
HUB_NAME = re.compile(r"[\w.-]+/[\w.-]+")
"""The form `USER/NAME`."""
MOST_BYTES = 1 << 20
"""Maximum size of a file."""
in_one_thread = ThreadpoolController().wrap(limits=1, user_api="blas")
"""Decorator: NumPy multiplies matrices in the calling thread. The matrices are small: on a busy machine, threads of the
BLAS library would take several times as long."""


class Weights(NamedTuple):
    """The content of a network's file."""

    parameters: dict[str, Array]
    metadata: dict[str, Any]
    digest: str
    """First 16 digits of the file's SHA-256."""


class NumpyNetwork:
    """A network in NumPy.

    Args:
        weights: The content of an exported file.
    """

    def __init__(self, weights: Weights) -> None:
        self.parameters, self.metadata, self.digest = weights

    def _layer(self, name: str, x: Array) -> Array:
        """A linear layer, float32[..., outputs]."""
        y = x.reshape(-1, x.shape[-1]) @ self.parameters[f"{name}.weight"].T + self.parameters[f"{name}.bias"]
        return y.reshape(*x.shape[:-1], y.shape[1])

    def _normalise(self, name: str, x: Array) -> Array:
        """PyTorch's LayerNorm."""
        centred = x - x.mean(axis=-1, keepdims=True)
        x = centred / np.sqrt(np.mean(centred**2, axis=-1, keepdims=True) + EPSILON)
        return x * self.parameters[f"{name}.weight"] + self.parameters[f"{name}.bias"]

    def check_telemetry(self, path: Path, task: TaskConfig) -> None:
        """Check that a task has the telemetry that the network from this file takes.

        Raises:
            CheckpointError: if it has other telemetry.
        """
        takes, size = self.metadata["telemetry_size"], task.telemetry_size
        if takes != size:
            raise CheckpointError(f"{path} takes {takes} values of telemetry, and {task.id!r} has {size}")


def write_weights(path: Path, parameters: Mapping[str, Array], metadata: Mapping[str, Any]) -> None:
    """Write a network to a file, and create missing folders."""
    content = save(
        {name: _smallest(array) for name, array in parameters.items()}, {METADATA: json.dumps(metadata, sort_keys=True)}
    )
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def _smallest(array: Array) -> npt.NDArray[Any]:
    """The same numbers in float16 if it holds all of them."""
    with np.errstate(over="ignore"):
        half = array.astype(np.float16)
    return half if np.array_equal(half, array) else array


def read_weights(path: Path, network: str) -> Weights:
    """Read the file of a network.

    Raises:
        OSError: if the file cannot be read.
        CheckpointError: if it contains no such network. `rejecting` turns errors of parameters that do not fit into it.
    """
    with rejecting(path):
        weights = _read(path)
        found = weights.metadata.get("network", PATHQNET)
        if found != network:
            raise ValueError(f"it contains a network of {abbreviate(found)}, not of {network!r}")
        for name, array in weights.parameters.items():
            if array.dtype.name not in ("float16", "float32") or not np.isfinite(array).all():
                raise ValueError(f"{name} is not float32, or has NaN or infinity")
            weights.parameters[name] = array.astype(np.float32)
        return weights


def local_file(path: Path) -> Path:
    """Return the file of a network: the path, the one in a folder for the Hub, or the download of `USER/NAME`.

    Raises:
        MissingPackageError: if it is to be downloaded, and the client of the Hub is not installed.
        CheckpointError: if it is not on the Hub, or the Hub cannot be reached.
    """
    name = path.as_posix()
    if path.is_dir():
        return path / HUB_FILE
    if path.exists() or path.suffix == ".safetensors" or not HUB_NAME.fullmatch(name):
        return path
    with needs("hub"):
        from huggingface_hub import hf_hub_download  # pyright: ignore[reportUnknownVariableType]
    try:
        return Path(hf_hub_download(name, HUB_FILE))
    except (OSError, ValueError) as error:
        raise CheckpointError(f"{name} is no file here, and the Hub does not give it: {error}") from None


def network_of(path: Path) -> str:
    """The network that a file names in its metadata."""
    with rejecting(path):
        return str(_read(path).metadata.get("network", PATHQNET))


@contextmanager
def rejecting(path: Path) -> Generator[None, None, None]:
    """Inside the `with`, an error means that a file is not an exported network.

    Raises:
        CheckpointError: from any error but an OSError.
    """
    try:
        yield
    except OSError:
        raise
    except Exception as error:  # damaged files, and parameters that do not fit, raise many types
        reason = f"it lacks {error}" if isinstance(error, KeyError) else str(error).removeprefix(f"{path} ")
        raise CheckpointError(
            f"{path} is not an exported network (.safetensors, beside the checkpoint): {reason}"
        ) from None


def _read(path: Path) -> Weights:
    content = read_file(path, MOST_BYTES)
    parameters = load(content)
    header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    metadata = json.loads(header["__metadata__"][METADATA])
    if not isinstance(metadata, dict):
        raise ValueError("its metadata is not a JSON object")
    return Weights(parameters, cast(dict[str, Any], metadata), hashlib.sha256(content).hexdigest()[:16])
