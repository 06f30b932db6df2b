"""PathQNet: its layers, the same in PyTorch and in NumPy, the agent that flies by it, and the shipped networks."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import save

from drone_env.agents import make_agent
from drone_env.agents.pathqnet import load_network, shipped_network
from drone_env.agents.weights_file import METADATA, write_weights
from drone_env.core.cells import N_CELL_KINDS
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import CheckpointError, InvalidValueError, UnsupportedTaskError
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.rl.model import PathQNet

SHIPPED = ("easy", "medium", "hard")
MAPS = 300 if int(os.environ.get("DRONE_ENV_EXAMPLES", "0")) >= 10_000 else 60
"""On how many of the test maps the shipped networks are judged."""


def export(network: PathQNet, path: Path, telemetry_size: int = 5) -> dict[str, Any]:
    """Write the network to a file and return its parameters."""
    parameters = {name: tensor.detach().numpy() for name, tensor in network.state_dict().items()}
    write_weights(path, parameters, {"telemetry_size": telemetry_size})
    return parameters


@pytest.mark.feature("L1")
def test_the_network_is_as_drawn() -> None:
    shapes = {name: tuple(tensor.shape) for name, tensor in PathQNet().state_dict().items() if name.endswith("weight")}
    assert shapes == {
        "encoder.embedding.weight": (9, 8),  # a row for each of the 9 kinds of cells
        "encoder.conv1.weight": (16, 8, 3, 3),
        "encoder.conv2.weight": (32, 16, 3, 3),
        "encoder.linear.weight": (64, 512),
        "head.0.weight": (128, 69),
        "head.1.weight": (128,),
        "head.3.weight": (128, 128),
        "head.5.weight": (64, 128),
        "head.7.weight": (5, 64),
    }
    assert isinstance(PathQNet().head[1], torch.nn.LayerNorm)


@pytest.mark.feature("L1")
def test_a_flat_map_has_the_values_of_a_square_one() -> None:
    network, telemetry = PathQNet(), torch.rand(3, 5)
    grids = torch.randint(N_CELL_KINDS, (3, 10, 10), dtype=torch.uint8)
    assert torch.equal(network(grids.flatten(1), telemetry), network(grids, telemetry))
    with pytest.raises(InvalidValueError, match="must be square, got 77 cells: pass"):
        network(torch.zeros(3, 77, dtype=torch.uint8), telemetry)


@pytest.mark.parametrize(("height", "width", "telemetry_size"), [(18, 18, 6), (3, 2, 5)])
def test_the_network_without_torch_is_the_same(height: int, width: int, telemetry_size: int, tmp_path: Path) -> None:
    torch.manual_seed(height)
    network = PathQNet(telemetry_size)
    export(network, tmp_path / "net.safetensors", telemetry_size)
    rng = np.random.default_rng(0)
    grids = rng.integers(0, N_CELL_KINDS, (20, height, width), dtype=np.uint8)
    telemetry = rng.random((20, telemetry_size), dtype=np.float32)
    with torch.no_grad():
        expected = network(torch.from_numpy(grids), torch.from_numpy(telemetry)).numpy()
    found = load_network(tmp_path / "net.safetensors")(grids, telemetry)
    assert found.shape == (20, 5)
    assert np.abs(found - expected).max() < 1e-5


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_network_flies_as_its_card_says(name: str) -> None:
    task = get_task(name)
    path = shipped_network(task)
    network = load_network(path)
    assert (network.metadata["task"], network.metadata["task_version"]) == (task.id, task.version)
    card = path.with_suffix(".md").read_text(encoding="utf-8")
    assert f"`drone-env train --task {task.short_name}" in card
    assert f"{network.metadata['updates']:,} updates" in card
    figures = summarise(run_episodes(episodes_key(name, "pathqnet", split_seeds("test", MAPS), "test")))
    assert figures["success_rate"] > 0.99
    assert figures["score_ratio"] > 0.995


def test_a_network_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "net.safetensors"
    export(PathQNet(), path)
    with pytest.raises(CheckpointError, match="takes 5 values of telemetry"):
        make_agent(f"pathqnet:{path}", "skyline_easy")
    with pytest.raises(FileNotFoundError):
        make_agent(f"pathqnet:{tmp_path / 'gone.safetensors'}", "easy")
    with pytest.raises(UnsupportedTaskError, match="no network is shipped"):
        make_agent("pathqnet", "skyline_hard")


def test_a_hostile_file_is_refused_by_name(tmp_path: Path) -> None:
    path, about, bias = tmp_path / "hostile.safetensors", {METADATA: '{"telemetry_size": 5}'}, np.zeros(5, np.float32)
    whole = export(PathQNet(), path)
    for content, why in (
        (save({"head.7.bias": bias}, about), "it lacks 'encoder.embedding.weight'"),
        (save(whole | {"head.7.bias": bias[1:]}, about), r"could not be broadcast together with shapes \(1,5\) \(4,\)"),
        (save(whole | {"head.7.bias": bias + np.nan}, about), "head.7.bias is not float32, or has NaN"),
        (save(whole, {"format": "pt"}), "it lacks 'drone_env'"),
        (save(whole, {METADATA: "[]"}), "its metadata is not a JSON object"),
        (b"no network", "header"),
    ):
        path.write_bytes(content)
        with pytest.raises(CheckpointError, match=rf"hostile\.safetensors is not an exported network.*: .*{why}"):
            load_network(path)
