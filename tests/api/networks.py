"""Network files for tests: variants of a shipped network, or random ones."""

from pathlib import Path
from typing import Any

import numpy as np

from drone_env.agents.pathqnet import load_network, shipped_network
from drone_env.agents.tour_network import load_tour_network
from drone_env.agents.tournet import SHIPPED
from drone_env.agents.weights_file import write_weights
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.planning.nearby import ENTRIES


def put_network(task: TaskConfig, folder: Path) -> Path:
    """Write a network for the telemetry of a task into a folder of shipped networks, and return its file."""
    return write_network(task, folder / f"{task.id}_v{task.version}.safetensors")


def put_trained(task: TaskConfig, data: Path, times: float = -1) -> Path:
    """Write a trained network into the data folder, with the shipped values times a factor, and return its file."""
    data.mkdir(exist_ok=True)
    return write_network(task, data / f"{task.short_name}.safetensors", times)


def write_network(task: TaskConfig, file: Path, times: float = 1) -> Path:
    """Write a network to a file, and return the file."""
    arrays = load_network(shipped_network(get_task("easy"))).parameters
    first = arrays["head.0.weight"]
    more = task.telemetry_size - 5
    # Small weights for the additional inputs, so that the values depend on all of them.
    arrays["head.0.weight"] = np.concatenate([first, np.full((len(first), more), 0.1, first.dtype)], axis=1)
    for name in ("head.7.weight", "head.7.bias"):
        arrays[name] = arrays[name] * np.float32(times)
    write_weights(file, arrays, {"telemetry_size": task.telemetry_size})
    return file


def put_tour(file: Path, seed: int = 0) -> Path:
    """Write a tour network with random weights, and return its file."""
    shapes = {name: array.shape for name, array in load_tour_network(SHIPPED).parameters.items()}
    return put_random(file, shapes, {"network": "tournet"}, seed)


def put_policy(task: TaskConfig, data: Path) -> Path:
    """Write a policy of PPO with random weights into the data folder, and return its file."""
    shapes = {"stops.weight": (ENTRIES, 4), "features.weight": (4, task.telemetry_size + 6), "features.bias": (4,)}
    shapes |= {"hidden.weight": (4, 4), "hidden.bias": (4,), "actor.weight": (5, 4), "actor.bias": (5,)}
    file = data / f"ppo_{task.short_name}.safetensors"
    return put_random(
        file, shapes, {"network": "ppo", "telemetry_size": task.telemetry_size, "config": {"shield": False}}
    )


def put_random(file: Path, shapes: dict[str, tuple[int, ...]], metadata: dict[str, Any], seed: int = 0) -> Path:
    file.parent.mkdir(exist_ok=True)
    rng = np.random.default_rng(seed)
    parameters: dict[str, Any] = {name: rng.normal(0, 0.1, shape).astype("f4") for name, shape in shapes.items()}
    write_weights(file, parameters, metadata)
    return file
