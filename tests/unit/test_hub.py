"""Networks of the Hub, in its cache; nothing is sent or downloaded."""

import sys
from pathlib import Path

import pytest
from huggingface_hub import constants
from safetensors.numpy import load_file

from drone_env.agents import make_agent
from drone_env.agents.pathqnet import shipped_network
from drone_env.agents.weights_file import write_weights
from drone_env.core.tasks import get_task
from drone_env.errors import CheckpointError, MissingPackageError


def test_agents_take_paths_first_then_models_of_the_hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    cached = tmp_path / "cache" / "models--ada--easy-dqn"
    (cached / "refs").mkdir(parents=True)
    (cached / "refs" / "main").write_text("0" * 40)
    (cached / "snapshots" / ("0" * 40)).mkdir(parents=True)
    metadata = {"telemetry_size": 5, "task": "easy_delivery"}
    easy = shipped_network(get_task("easy"))
    write_weights(cached / "snapshots" / ("0" * 40) / "model.safetensors", load_file(easy), metadata)
    monkeypatch.chdir(tmp_path)
    downloaded = make_agent("pathqnet:ada/easy-dqn", "easy")
    (tmp_path / "ada").mkdir()
    (tmp_path / "ada" / "easy-dqn").write_bytes(easy.read_bytes())
    assert make_agent("pathqnet:ada/easy-dqn", "easy").config != downloaded.config
    with pytest.raises(CheckpointError, match="ada/unknown is no file here, and the Hub does not give it: "):
        make_agent("ppo:ada/unknown", "easy")
    with pytest.raises(FileNotFoundError):
        make_agent("pathqnet:data/easy.safetensors", "easy")
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(MissingPackageError, match=r"huggingface_hub is not installed; run: .*\[hub\]"):
        make_agent("tournet:ada/tour", "easy")
