"""Networks from a shipped one or by chance: what they answer matters to no test, but that they do not answer alike."""

from pathlib import Path
from typing import Any

import numpy as np

from drone_env.agents.pathqnet import load_network, shipped_network
from drone_env.agents.tour_network import SHAPES
from drone_env.agents.weights_file import write_weights
from drone_env.core.tasks import TaskConfig, get_task


def put_network(task: TaskConfig, folder: Path) -> Path:
    """Put a network that takes the telemetry of `task` into a folder of weights, and return its file."""
    return write_network(task, folder / f"{task.id}_v{task.version}.safetensors")


def put_trained(task: TaskConfig, data: Path, times: float = -1) -> Path:
    """Put one where training leaves it, its values those of the shipped one times a number, and return its file."""
    data.mkdir(exist_ok=True)
    return write_network(task, data / f"{task.short_name}.safetensors", times)


def write_network(task: TaskConfig, file: Path, times: float = 1) -> Path:
    """Write one to a file, which is returned."""
    arrays = load_network(shipped_network(get_task("easy"))).parameters
    first = arrays["head.0.weight"]
    more = task.telemetry_size - 5
    # What the network has never seen weighs a little, so that its answers follow from all it is given.
    arrays["head.0.weight"] = np.concatenate([first, np.full((len(first), more), 0.1, first.dtype)], axis=1)
    for name in ("head.7.weight", "head.7.bias"):
        arrays[name] = arrays[name] * np.float32(times)
    write_weights(file, arrays, {"telemetry_size": task.telemetry_size})
    return file


def put_tour(file: Path, seed: int = 0) -> Path:
    """Put a tour network of random weights, and return its file."""
    file.parent.mkdir(exist_ok=True)
    rng = np.random.default_rng(seed)
    parameters: dict[str, Any] = {name: rng.normal(0, 0.1, shape).astype(np.float32) for name, shape in SHAPES.items()}
    write_weights(file, parameters, {"network": "tournet"})
    return file
