"""The files of a training: checkpoints, and the exported network.

A checkpoint is all that a run needs to go on as if it had never stopped. It holds tensors and plain values only, so it
is read with `weights_only=True` and can run no code. It is written beside its place, synced and renamed: there is
always a whole one. An exported network is read by `agents.network`, without PyTorch.
"""

import json
import os
import pickle
import struct
import zipfile
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
import torch
from torch import nn

from drone_env.errors import CheckpointError, InvalidValueError
from drone_env.files import open_file, replacing

FORMAT = "drone_env/checkpoint"
VERSION = 2
UNREADABLE = (pickle.UnpicklingError, zipfile.BadZipFile, struct.error, RuntimeError, EOFError, MemoryError,
              ValueError, TypeError, LookupError, AttributeError, AssertionError, ArithmeticError)  # fmt: skip
"""What reading a damaged archive, its pickle or its tensors raises."""


def save_checkpoint(path: Path, contents: dict[str, Any]) -> None:
    """Write a checkpoint; folders are made.

    Raises:
        OSError: if it cannot be written; the file that was there before is left as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary, temporary.open("wb") as file:
        try:
            torch.save({"format": FORMAT, "version": VERSION, **contents}, file)
        except RuntimeError as error:  # as PyTorch says that the disk is full
            raise OSError(f"{path} could not be written: {str(error).splitlines()[0]}") from error
        file.flush()
        os.fsync(file.fileno())


def load_checkpoint(path: Path, device: str = "cpu") -> dict[str, Any]:
    """Read a checkpoint. The file is left as it is, whatever it holds.

    Raises:
        OSError: if it cannot be read.
        CheckpointError: if it is cut short, no checkpoint of this project, or of another version.
    """
    try:
        with open_file(path) as file:
            _require_plain(file)
            contents: Any = torch.load(file, map_location=device, weights_only=True)
    except InvalidValueError as error:
        raise CheckpointError(str(error)) from None
    except UNREADABLE as error:
        raise CheckpointError(f"{path} cannot be read: cut short, or no checkpoint ({type(error).__name__})") from None
    if not isinstance(contents, dict) or cast(dict[str, Any], contents).get("format") != FORMAT:
        raise CheckpointError(f"{path} is not a checkpoint of this project")
    contents = cast(dict[str, Any], contents)
    version = contents.get("version")
    if not isinstance(version, int) or version != VERSION:
        said = f"of version {version}" if isinstance(version, int) else "that does not say its version"
        raise CheckpointError(f"{path} is a checkpoint {said}; this program reads version {VERSION}")
    batch = contents.get("batch")
    if isinstance(batch, dict) and "rows" in batch:  # as earlier versions call the states
        batch["states"] = batch.pop("rows")
    return contents


def _require_plain(file: BinaryIO) -> None:
    """Refuse an archive that unpacks to more than the file has: `torch.save` compresses nothing."""
    size = os.fstat(file.fileno()).st_size
    with zipfile.ZipFile(file) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > size:
            raise zipfile.BadZipFile("it is compressed")
    file.seek(0)


def export_network(network: nn.Module, path: Path, metadata: dict[str, Any]) -> None:
    """Write a network without PyTorch's own format; folders are made. The file is whole or not there.

    Raises:
        OSError: if it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {name: tensor.detach().cpu().numpy() for name, tensor in network.state_dict().items()}
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, metadata=np.array(json.dumps(metadata, sort_keys=True)), **arrays)
