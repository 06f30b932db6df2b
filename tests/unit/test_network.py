"""PathQNet: its layers, the same in PyTorch and in NumPy, the agent that flies by it, and the shipped networks."""

import io
import json
import os
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fastapi.testclient import TestClient

from drone_env.agents import make_agent
from drone_env.agents.network import load_network, pooling
from drone_env.agents.pathqnet import CHUNK, PathQNetAgent, shipped_network
from drone_env.agents.weights_file import LARGEST, MOST_BYTES
from drone_env.core.actions import Action
from drone_env.core.batch import Batch
from drone_env.core.cells import N_CELL_KINDS
from drone_env.core.episode import Episode
from drone_env.core.seeds import split_seeds
from drone_env.core.tasks import get_task
from drone_env.errors import CheckpointError, InvalidValueError, UnsupportedTaskError
from drone_env.results.evaluate import episodes_key, run_episodes, summarise
from drone_env.rl.checkpoint import export_network
from drone_env.rl.model import MapEncoder, PathQNet
from drone_env.server.app import create_app
from drone_env.server.settings import Settings

SHIPPED = ("easy", "medium", "hard")
MAPS = 300 if int(os.environ.get("DRONE_ENV_EXAMPLES", "0")) >= 10_000 else 60
"""On how many of the test maps the shipped networks are judged."""


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
    for height, width in ((10, 10), (18, 18), (7, 11)):
        grids = torch.randint(0, 9, (3, height, width), dtype=torch.uint8)
        assert MapEncoder()(grids).shape == (3, 64)
        assert PathQNet()(grids, torch.rand(3, 5)).shape == (3, 5)
    network, grids, telemetry = PathQNet(), torch.randint(0, 9, (3, 14, 14)), torch.rand(3, 5)
    assert torch.equal(network(grids.flatten(1), telemetry), network(grids, telemetry))
    with pytest.raises(InvalidValueError, match=r"a flat map is square, got 77 cells; give the shape \(B, H, W\)"):
        network(torch.zeros(3, 77, dtype=torch.uint8), telemetry)


def test_the_layers_come_in_the_order_that_is_drawn() -> None:
    """The network once more, from PyTorch's own layers alone."""
    torch.manual_seed(0)
    network = PathQNet()
    encoder, head = network.encoder, network.head
    grids, telemetry = torch.randint(0, 9, (4, 10, 14), dtype=torch.uint8), torch.rand(4, 5)
    x = encoder.embedding(grids.long()).permute(0, 3, 1, 2)
    x = torch.relu(encoder.conv2(torch.relu(encoder.conv1(x))))
    x = torch.nn.AdaptiveAvgPool2d(4)(x)
    # What is pooled is laid out cell by cell, as the exported network lays it out.
    x = torch.cat([torch.relu(encoder.linear(x.permute(0, 2, 3, 1).flatten(1))), telemetry], dim=1)
    x = torch.relu(torch.nn.functional.layer_norm(head[0](x), (128,), head[1].weight, head[1].bias))
    x = head[7](torch.relu(head[5](torch.relu(head[3](x)))))
    assert torch.allclose(network(grids, telemetry), x, atol=1e-6)


@pytest.mark.feature("L2")
def test_five_values_of_telemetry() -> None:
    episode = Episode("easy")
    episode.reset(14)  # the drone at (6, 3), the parcel at (5, 1)
    np.testing.assert_allclose(episode.observation()["telemetry"], [0.6, 0.3, 1.0, 0.5, 0.1], rtol=1e-6)
    episode.step(Action.LEFT)
    np.testing.assert_allclose(episode.observation()["telemetry"], [0.5, 0.3, 59 / 60, 0.5, 0.1], rtol=1e-6)


@pytest.mark.parametrize(("height", "width"), [(10, 10), (14, 14), (18, 18), (7, 11), (3, 2)])
@pytest.mark.parametrize("telemetry_size", [5, 6])
def test_the_network_without_torch_is_the_same(height: int, width: int, telemetry_size: int, tmp_path: Path) -> None:
    torch.manual_seed(height)
    network = PathQNet(telemetry_size)
    export_network(network, tmp_path / "net.npz", {"telemetry_size": telemetry_size})
    rng = np.random.default_rng(0)
    grids = rng.integers(0, N_CELL_KINDS, (20, height, width), dtype=np.uint8)
    telemetry = rng.random((20, telemetry_size), dtype=np.float32)
    with torch.no_grad():
        expected = network(torch.from_numpy(grids), torch.from_numpy(telemetry)).numpy()
    found = load_network(tmp_path / "net.npz")(grids, telemetry)
    assert found.shape == (20, 5)
    assert np.abs(found - expected).max() < 1e-5


@pytest.mark.parametrize("size", [4, 10, 14, 18, 3])
def test_pooling_as_a_matrix_is_adaptive_average_pooling(size: int) -> None:
    x = torch.rand(1, 1, size, size)
    expected = torch.nn.functional.adaptive_avg_pool2d(x, 4)[0, 0].numpy()
    assert np.allclose(pooling(size) @ x[0, 0].numpy() @ pooling(size).T, expected, atol=1e-6)


def test_the_agent_flies_alone_as_in_a_batch() -> None:
    agent = make_agent("pathqnet", "easy")
    assert isinstance(agent, PathQNetAgent)
    episodes = [Episode("easy") for _ in range(30)]
    for seed, episode in enumerate(episodes):
        episode.reset(seed)
    observations = [episode.observation() for episode in episodes]
    grids = np.stack([observation["grid"] for observation in observations])
    telemetry = np.stack([observation["telemetry"] for observation in observations])
    alone = [agent.act(observation) for observation in observations]
    assert len(set(alone)) > 1
    assert agent.act_batch(grids, telemetry).tolist() == alone
    # More than it takes at a time, in another order in each part.
    order = np.random.default_rng(0).integers(0, 30, 2 * CHUNK + 1)
    assert agent.act_batch(grids[order], telemetry[order]).tolist() == [alone[i] for i in order]


def test_another_network_is_another_agent(tmp_path: Path) -> None:
    for seed in (1, 2):
        torch.manual_seed(seed)
        export_network(PathQNet(), tmp_path / f"{seed}.npz", {"telemetry_size": 5})
    configs = [make_agent(f"pathqnet:{tmp_path / f'{seed}.npz'}", "easy").config for seed in (1, 2)]
    assert configs[0] != configs[1]
    assert configs[0].keys() == configs[1].keys() == {"agent", "version", "network"}


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_network_has_a_card(name: str) -> None:
    task = get_task(name)
    path = shipped_network(task)
    network = load_network(path)
    assert (network.metadata["task"], network.metadata["task_version"]) == (task.id, task.version)
    card = path.with_suffix(".md").read_text(encoding="utf-8")
    assert f"`drone-env train --task {task.short_name}" in card
    assert f"{network.metadata['updates']:,} updates" in card
    assert PathQNetAgent(task).config == make_agent(f"pathqnet:{path}", task).config


@pytest.mark.parametrize("name", SHIPPED)
def test_the_shipped_network_is_the_same_in_torch(name: str) -> None:
    task = get_task(name)
    shipped = load_network(shipped_network(task))
    network = PathQNet(task.telemetry_size)
    network.load_state_dict({name: torch.from_numpy(array) for name, array in shipped.parameters.items()})
    batch = Batch(task, 32)
    batch.reset(np.array(split_seeds("test", 32)))
    for _ in range(8):
        found = shipped(batch.grids, batch.telemetry)
        with torch.no_grad():
            expected = network(torch.from_numpy(batch.grids), torch.from_numpy(batch.telemetry)).numpy()
        assert np.abs(found - expected).max() < 1e-5 * max(1, np.abs(expected).max())
        batch.step(found.argmax(axis=1))


@pytest.mark.parametrize("task", SHIPPED)
def test_the_shipped_network_flies_as_its_card_says(task: str) -> None:
    figures = summarise(run_episodes(episodes_key(task, "pathqnet", split_seeds("test", MAPS), "test")))
    assert figures["success_rate"] > 0.99
    assert figures["score_ratio"] > 0.995


@pytest.mark.feature("L7")
@pytest.mark.parametrize("name", SHIPPED)
def test_a_fresh_install_predicts_a_flight_to_its_end(name: str, tmp_path: Path) -> None:
    task = get_task(name)
    with TestClient(create_app(Settings(data=tmp_path / "data"))) as http:
        observation = http.post("/reset", json={"task_name": task.id, "seed": 14}).json()
        session = {"X-Session-Id": observation["session_id"]}
        while not observation["done"]:
            told = http.post("/predict", headers=session).json()
            assert told["action"] == max(told["q_values"], key=told["q_values"].get)
            observation = http.post("/step", json={"direction": told["action"]}, headers=session).json()
    assert observation["deliveries_done"] == task.deliveries


def test_a_network_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "net.npz"
    export_network(PathQNet(), path, {"telemetry_size": 5})
    with pytest.raises(CheckpointError, match="takes 5 values of telemetry"):
        make_agent(f"pathqnet:{path}", "skyline_easy")
    path.write_bytes(b"nothing")
    with pytest.raises(CheckpointError, match="not an exported network"):
        make_agent(f"pathqnet:{path}", "easy")
    with pytest.raises(FileNotFoundError):
        make_agent(f"pathqnet:{tmp_path / 'gone.npz'}", "easy")
    with pytest.raises(UnsupportedTaskError, match="no network is shipped"):
        make_agent("pathqnet", "skyline_hard")


# Files that are no networks


@pytest.fixture
def parts(tmp_path: Path) -> dict[str, bytes]:
    """The entries of an exported network."""
    export_network(PathQNet(), tmp_path / "whole.npz", {"telemetry_size": 5})
    with zipfile.ZipFile(tmp_path / "whole.npz") as archive:
        return {entry.filename: archive.read(entry) for entry in archive.infolist()}


def packed(parts: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytearray:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return bytearray(file.getvalue())


def array(value: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, np.asarray(value), allow_pickle=True)
    return file.getvalue()


def header(text: str) -> bytes:
    """An array without values whose header is this text."""
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def claims(shape: str, descr: str = "'<f4'") -> bytes:
    return header(f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n")


def encrypted(parts: dict[str, bytes]) -> bytearray:
    content = packed(parts)
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        found = content.find(signature)
        while found >= 0:
            content[found + offset] |= 1
            found = content.find(signature, found + 4)
    return content


def lying_bomb(parts: dict[str, bytes]) -> bytearray:
    """30 MB of zeros in an entry that says it has as many as it should."""
    told = len(parts["head.3.weight.npy"])
    content = packed({**parts, "head.3.weight.npy": parts["head.3.weight.npy"] + bytes(30_000_000)})
    real = struct.pack("<I", told + 30_000_000)
    assert content.count(real) == 2
    return content.replace(real, struct.pack("<I", told))


FIRST, METADATA = "head.0.weight.npy", "metadata.npy"
HOSTILE: dict[str, tuple[Callable[[dict[str, bytes]], bytes], str]] = {
    "a bomb": (lambda parts: packed({**parts, FIRST: bytes(30_000_000)}), "unpacked it would have 30"),
    "a bomb that lies": (lying_bomb, ""),
    "too large": (lambda parts: bytes(MOST_BYTES + 1), f"at most {MOST_BYTES:,} bytes"),
    "cut short": (lambda parts: packed(parts)[:-30], "not a zip file"),
    "encrypted": (encrypted, "encrypted"),
    "packed otherwise": (lambda parts: packed(parts, zipfile.ZIP_LZMA), "packed in a way"),
    "an entry is missing": (lambda parts: packed({FIRST: parts[FIRST]}), "does not hold the parameters"),
    "an entry too many": (lambda parts: packed({**parts, "more.npy": array(0)}), "and nothing else"),
    "more than there is": (lambda parts: packed({**parts, FIRST: claims(f"({10**15},)")}), "has 0"),
    "nested header": (lambda parts: packed({**parts, FIRST: header("-" * 9000 + "1\n")}), ""),
    "no array": (lambda parts: packed({**parts, FIRST: b"nothing"}), ""),
    "objects": (lambda parts: packed({**parts, FIRST: array([print])}), ""),
    "another shape": (lambda parts: packed({**parts, FIRST: array(np.zeros((128, 70), np.float32))}),
                      r"head.0.weight is float32\[128, 70\] instead of float32\[128, 69\]"),
    "whole numbers": (lambda parts: packed({**parts, FIRST: array(np.zeros((128, 69), np.int32))}), "is int32"),
    "no number": (lambda parts: packed({**parts, "head.7.bias.npy": array(np.float32([0, 0, np.nan, 0, 0]))}),
                  "head.7.bias has values that are no numbers"),
    "overflow": (lambda parts: packed({**parts, "head.7.bias.npy": array(np.full(5, 2 * LARGEST, np.float32))}),
                 "beyond 100"),
    "metadata of a list": (lambda parts: packed({**parts, METADATA: array(json.dumps([5]))}), "no JSON object"),
    "metadata of numbers": (lambda parts: packed({**parts, METADATA: array(5)}), "no text"),
    "nested metadata": (lambda parts: packed({**parts, METADATA: array("[" * 50_000)}), ""),
    "metadata without a size": (lambda parts: packed({**parts, METADATA: array("{}")}), "telemetry_size"),
    "a size that is none": (lambda parts: packed({**parts, METADATA: array('{"telemetry_size": [5]}')}),
                            "telemetry_size"),
}  # fmt: skip


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_by_name_and_in_bounded_memory(
    name: str, tmp_path: Path, parts: dict[str, bytes]
) -> None:
    make, why = HOSTILE[name]
    path = tmp_path / "hostile.npz"
    path.write_bytes(make(parts))
    load_network(tmp_path / "whole.npz")
    tracemalloc.start()
    try:
        with pytest.raises(CheckpointError, match=rf"hostile\.npz is not an exported network.*: .*{why}"):
            load_network(path)
        assert tracemalloc.get_traced_memory()[1] < 8_000_000
    finally:
        tracemalloc.stop()


def test_the_largest_weights_that_are_taken_do_not_overflow(tmp_path: Path, parts: dict[str, bytes]) -> None:
    rng = np.random.default_rng(0)
    for sign in (np.ones_like, lambda shape: rng.choice(np.float32([-1, 1]), shape.shape)):
        large = {
            name: array(np.float32(LARGEST) * sign(np.load(io.BytesIO(content))))
            for name, content in parts.items()
            if name != METADATA
        }
        (tmp_path / "large.npz").write_bytes(packed({**large, METADATA: parts[METADATA]}))
        network = load_network(tmp_path / "large.npz")
        grids = rng.integers(0, N_CELL_KINDS, (8, 18, 18), dtype=np.uint8)
        assert np.isfinite(network(grids, np.ones((8, 5), np.float32))).all()
