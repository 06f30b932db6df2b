"""Files of networks, and how they are read safely.

A file is NumPy's `.npz`: one array per parameter, under PyTorch's names, and `metadata`, JSON text. Its entry `network`
says whose the parameters are; where it is missing they are PathQNet's.
"""

import hashlib
import json
import math
import stat
import struct
import tokenize
import zlib
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple, cast
from zipfile import ZIP_DEFLATED, ZIP_STORED, BadZipFile, ZipFile

import numpy as np
import numpy.typing as npt

from drone_env.core.tasks import withdrawal
from drone_env.errors import CheckpointError

WEIGHTS = Path(__file__).parents[1] / "weights"
"""Where the networks lie that are shipped."""
Array = npt.NDArray[np.float32]
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
UNREADABLE = (ValueError, TypeError, BadZipFile, zlib.error, struct.error, EOFError, NotImplementedError,
              RecursionError, MemoryError, OverflowError, SyntaxError, tokenize.TokenError)  # fmt: skip
"""What is raised over a malformed archive, array or JSON. Sizes are checked before, so memory is that of the parser."""


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
        CheckpointError: if it is not such a file, or was trained on a version of a task that is withdrawn; the message
            says why.
    """
    try:
        content = _content(path)
        archive = _archive(content)
        metadata = _metadata(archive)
        found = metadata.get("network", PATHQNET)
        if found != network:
            raise ValueError(f"it holds a network of {str(found)[:40]!r}, not of {network!r}")
        parameters = _parameters(archive, shapes_of(metadata))
    except UNREADABLE as error:
        raise _refused(path, error) from None
    several = metadata.get("tasks")
    trained_on: dict[Any, Any] = cast(dict[Any, Any], several) if isinstance(several, dict) else {}
    for task, version in {metadata.get("task"): metadata.get("task_version"), **trained_on}.items():
        withdrawn = withdrawal(task, version)
        if withdrawn is not None:
            raise CheckpointError(f"{path} was trained on what there is no more: {withdrawn}")
    return Weights(parameters, metadata, hashlib.sha256(content).hexdigest()[:16])


def network_of(path: Path) -> str:
    """Whose parameters a file holds, by its metadata.

    Raises:
        OSError: if it cannot be read.
        CheckpointError: if it is no file of a network.
    """
    try:
        return str(_metadata(_archive(_content(path))).get("network", PATHQNET))
    except UNREADABLE as error:
        raise _refused(path, error) from None


def _refused(path: Path, error: BaseException) -> CheckpointError:
    why = str(error) or type(error).__name__
    return CheckpointError(f"{path} is not an exported network (.npz, beside the checkpoint): {why}")


def _content(path: Path) -> bytes:
    if not stat.S_ISREG(path.stat().st_mode):
        raise ValueError("it is no file")
    with path.open("rb") as file:
        content = file.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise ValueError(f"it has more than {MOST_BYTES} bytes")
    return content


def _archive(content: bytes) -> ZipFile:
    archive = ZipFile(BytesIO(content))
    declared = sum(entry.file_size for entry in archive.infolist())
    if declared > MOST_BYTES:
        raise ValueError(f"unpacked it would have {declared} bytes, and a network has at most {MOST_BYTES}")
    return archive


def _parameters(archive: ZipFile, shapes: Shapes) -> dict[str, Array]:
    """The parameters in an archive, if they are those of a network: by name, type, shape and size."""
    if sorted(archive.namelist()) != sorted(f"{name}.npy" for name in (*shapes, METADATA)):
        raise ValueError(NOT_WHOLE)
    parameters: dict[str, Array] = {}
    for name, shape in shapes.items():
        array = _array(archive, name)
        if array.dtype != np.float32 or array.shape != shape:
            raise ValueError(f"{name} is {array.dtype}{list(array.shape)} instead of float32{list(shape)}")
        if not (np.abs(array) <= LARGEST).all():
            raise ValueError(f"{name} has values that are no numbers, or beyond {LARGEST:g}")
        parameters[name] = array
    return parameters


def _metadata(archive: ZipFile) -> dict[str, Any]:
    if f"{METADATA}.npy" not in archive.namelist():
        raise ValueError(NOT_WHOLE)
    array = _array(archive, METADATA)
    if array.shape != () or array.dtype.kind != "U":
        raise ValueError("its metadata are no text")
    metadata = json.loads(str(array))
    if not isinstance(metadata, dict):
        raise ValueError("its metadata are no JSON object")
    return cast(dict[str, Any], metadata)


def _array(archive: ZipFile, name: str) -> npt.NDArray[Any]:
    """The array in an entry. NumPy's own reader makes room for as many values as the header claims."""
    entry = archive.getinfo(f"{name}.npy")
    if entry.flag_bits & 1 or entry.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
        raise ValueError(f"{entry.filename} is encrypted, or packed in a way that NumPy does not write")
    with archive.open(entry) as opened:
        # Bounded: unpacked without a number, an entry that lies about its size would be unpacked whole.
        content = opened.read(entry.file_size + 1)
    file = BytesIO(content)
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise ValueError(f"it has arrays of version {version}, and networks are written with those of (1, 0)")
    shape, by_columns, dtype = np.lib.format.read_array_header_1_0(file)
    values = np.frombuffer(content[file.tell() :], dtype)
    if values.shape != (math.prod(shape),):
        raise ValueError(f"an array of {list(shape)} values has {len(values)}")
    return values.reshape(shape, order="F" if by_columns else "C").copy()
