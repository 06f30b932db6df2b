"""The promises of learning."""

import json
import os
import subprocess
import sys
import time
from dataclasses import fields
from pathlib import Path

import gymnasium
import httpx
import numpy as np
import pytest
import torch

from drone_env import TASKS
from drone_env.cli import main
from drone_env.rl.checkpoint import load_checkpoint
from drone_env.rl.config import ORIGINAL, TrainConfig
from drone_env.rl.model import MapEncoder, PathQNet
from drone_env.rl.policy import EpsilonGreedyPolicy, MultiplicativeSchedule
from tests.api.serving import ROOT, Server
from tests.browser.flights import fill, flown

TRAIN = [
    "--task", "easy_delivery", "--preset", "original", "--steps-per-update", "64", "--validation-maps", "5",
    "--num-threads", "1",
]  # fmt: skip
"""The original's hyperparameters, but for how often it learns: a test has no time."""


@pytest.mark.feature("L1")
def test_l1_the_network_is_as_drawn() -> None:
    """PathQNet: a convolutional map encoder and a dense head with LayerNorm, for maps of any size"""
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


@pytest.mark.feature("L2")
def test_l2_five_values_of_telemetry() -> None:
    """Telemetry: x/width, y/height, battery, target x/width, target y/height"""
    env = gymnasium.make("drone_env:DroneDelivery-Easy-v1")
    observation, _ = env.reset(seed=14)  # the drone at (6, 3), the parcel at (5, 1)
    np.testing.assert_allclose(observation["telemetry"], [0.6, 0.3, 1.0, 0.5, 0.1], rtol=1e-6)
    observation, *_ = env.step(2)
    np.testing.assert_allclose(observation["telemetry"], [0.5, 0.3, 59 / 60, 0.5, 0.1], rtol=1e-6)


@pytest.mark.feature("L3")
def test_l3_exploration_decays_by_both_schedules() -> None:
    """EpsilonGreedyPolicy decays linearly, 1.0 to 0.05 in 5000 steps; the training loop by 0.995 per episode"""
    policy = EpsilonGreedyPolicy(eps_start=1.0, eps_end=0.05, decay_steps=5000)
    assert [policy.epsilon(step) for step in (0, 2500, 5000, 9000)] == pytest.approx([1.0, 0.525, 0.05, 0.05])
    assert vars(EpsilonGreedyPolicy().schedule) == vars(policy.schedule)
    values = np.tile(np.array([0, 0, 1, 0, 0], np.float32), (10_000, 1))
    for step, share in ((0, 0.2), (2500, 0.475 + 0.525 / 5), (5000, 0.95 + 0.05 / 5)):
        chosen = policy.act(values, step, np.random.default_rng(0))
        assert (chosen == 2).mean() == pytest.approx(share, abs=0.02)
    assert ORIGINAL.exploration == "multiplicative"
    epsilon = MultiplicativeSchedule(ORIGINAL.epsilon_start, ORIGINAL.epsilon_end, ORIGINAL.epsilon_factor)
    assert [epsilon(episode) for episode in (0, 1, 2, 1000)] == pytest.approx([1.0, 0.995, 0.995**2, 0.05])


@pytest.mark.feature("L4")
def test_l4_train_py_trains_with_the_originals_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """python train.py --task TASK --episodes N [--gpu] trains a DQN; the preset original has the first numbers"""
    assert (ORIGINAL.gamma, ORIGINAL.batch_size, ORIGINAL.learning_rate) == (0.99, 64, 1e-4)
    assert (ORIGINAL.replay_size, ORIGINAL.target_update, ORIGINAL.target_every) == (10_000, "episodes", 10)
    assert (ORIGINAL.epsilon_start, ORIGINAL.epsilon_end) == (1.0, 0.05)
    command = [sys.executable, str(ROOT / "train.py"), *TRAIN, "--episodes", "3"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    checkpoint = load_checkpoint(tmp_path / "data/easy.pth")
    assert checkpoint["config"] | {"steps_per_update": 1, "validation_maps": 500, "num_threads": 2} == (
        ORIGINAL.identity()
    )
    with pytest.raises(SystemExit):
        main(["train", "--help"])
    flags = capsys.readouterr().out
    assert all(f"--{field.name.replace('_', '-')}" in flags for field in fields(TrainConfig))
    gpu = ["train", *TRAIN, "--episodes", "1", "--gpu", "--data", str(tmp_path / "gpu"), "--results", str(tmp_path)]
    assert main(gpu) == (0 if torch.cuda.is_available() else 2)
    assert "CUDA" in capsys.readouterr().err or torch.cuda.is_available()


@pytest.fixture(scope="module")
def lines(server: Server, tmp_path_factory: pytest.TempPathFactory) -> list[int]:
    """Trains into the server's data folder up to the first checkpoint, and kills that; the lines `/logs` told on."""
    results = tmp_path_factory.mktemp("results")
    command = [sys.executable, "train.py", *TRAIN, "--episodes", "100000", "--data", str(server.data)]
    seen: list[int] = []
    with (results / "output").open("wb") as output:
        process = subprocess.Popen([*command, "--results", str(results)], cwd=ROOT, stdout=output, stderr=output)
        while not (server.data / "easy.pth").exists():
            assert process.poll() is None, (results / "output").read_text()
            seen.append(len(httpx.get(f"{server.url}/logs").json()["lines"]))
            time.sleep(0.02)
        process.kill()
        process.wait()
    return seen


@pytest.mark.feature("L5")
def test_l5_checkpoints_and_automatic_resume(
    server: Server, lines: list[int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A checkpoint every 50 episodes in data/easy.pth; training goes on from it, and anew where it was deleted"""
    checkpoint = server.data / "easy.pth"
    flown = load_checkpoint(checkpoint)["counters"][2]
    assert flown in (50, 100)
    train = ["train", *TRAIN, "--data", str(server.data), "--results", str(tmp_path)]
    assert main([*train, "--episodes", str(flown + 2)]) == 0
    assert f"going on from {checkpoint}: {flown} of {flown + 2} episodes" in " ".join(capsys.readouterr().err.split())
    checkpoint.unlink()
    assert main([*train, "--episodes", "2"]) == 0
    assert "going on" not in capsys.readouterr().err
    assert load_checkpoint(checkpoint)["counters"][2] == 2


@pytest.mark.feature("L6")
def test_l6_a_live_log_and_a_memory_of_100_episodes(server: Server, lines: list[int], tmp_path: Path) -> None:
    """data/train.log grows while it trains, /logs shows it; data/memory.json holds the last 100 episodes"""
    assert lines == sorted(lines)
    assert len(set(lines)) > 2, "it was not seen to grow"
    last = httpx.get(f"{server.url}/logs").json()["lines"][-1]
    assert last == (server.data / "train.log").read_text(encoding="utf-8").splitlines()[-1]
    assert last.startswith("episode=")
    fill(tmp_path, [flown("easy", seed, "greedy") for seed in range(102)])
    memory = json.loads((tmp_path / "memory.json").read_text(encoding="utf-8"))["episodes"]
    assert [episode["record"]["seed"] for episode in memory] == list(range(2, 102))


@pytest.mark.feature("L7")
@pytest.mark.parametrize("task", ["easy_delivery", "medium_delivery", "hard_delivery"])
def test_l7_predict_asks_the_shipped_network(server: Server, task: str) -> None:
    """POST /predict tells the next action of the trained network, on a fresh install"""
    with httpx.Client(base_url=server.url, timeout=30) as http:
        observation = http.post("/reset", json={"task_name": task, "seed": 14}).json()
        while not observation["done"]:
            told = http.post("/predict").json()
            assert told["action"] == max(told["q_values"], key=told["q_values"].get)
            observation = http.post("/step", json={"direction": told["action"]}).json()
    assert observation["deliveries_done"] == TASKS[task].deliveries
