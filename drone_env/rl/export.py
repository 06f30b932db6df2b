"""From a PyTorch network to the file that `agents.network` reads without PyTorch."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from drone_env.files import replacing
from drone_env.rl.model import PathQNet


def parameters_of(network: PathQNet) -> dict[str, npt.NDArray[np.float32]]:
    """The parameters as arrays."""
    return {name: tensor.detach().cpu().numpy() for name, tensor in network.state_dict().items()}


def export_network(network: PathQNet, path: Path, metadata: dict[str, Any]) -> None:
    """Write the file, whole or not at all.

    Raises:
        OSError: if it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = parameters_of(network)
    with replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, metadata=np.array(json.dumps(metadata, sort_keys=True)), **arrays)
