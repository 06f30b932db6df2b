"""Networks as models of the Hub, in folders and in its cache; nothing is sent or downloaded."""

import sys
from pathlib import Path

import pytest
from huggingface_hub import constants
from safetensors.numpy import load_file

from drone_env.agents import make_agent
from drone_env.agents.hub import HubNetwork
from drone_env.agents.pathqnet import shipped_network
from drone_env.agents.weights_file import write_weights
from drone_env.core.tasks import get_task
from drone_env.errors import CheckpointError, MissingPackageError
from drone_env.rl.config import preset

CONFIG = preset("fast", "easy")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The shipped network of easy in a folder for the Hub, with the metadata of a training now."""
    scores = {"task": "easy_delivery", "validation_score": 0.95, "validation_optimum": 0.97742}
    metadata = {"telemetry_size": 5, "config": CONFIG.identity(), "episodes": CONFIG.episodes, **scores}
    write_weights(tmp_path / "easy.safetensors", load_file(shipped_network(get_task("easy"))), metadata)
    HubNetwork(tmp_path / "easy.safetensors").save_pretrained(tmp_path / "easy-dqn")
    return tmp_path / "easy-dqn"


def test_a_folder_for_the_hub_has_the_network_its_metadata_and_a_card(folder: Path) -> None:
    loaded = HubNetwork.from_pretrained(folder)
    assert loaded.file.read_bytes() == folder.with_name("easy.safetensors").read_bytes()
    assert (loaded.network, loaded.metadata["validation_score"]) == ("pathqnet", 0.95)
    assert sorted(file.name for file in folder.iterdir()) == ["README.md", "config.json", "model.safetensors"]
    card = (folder / "README.md").read_text(encoding="utf-8")
    assert "first 500 maps of the validation split" in card
    assert "| easy_delivery | 0.9500 | 0.9774 | 0.9719 |" in card
    # Without the metadata of a training there is nothing to write.
    write_weights(folder / "model.safetensors", load_file(loaded.file), {"telemetry_size": 5})
    with pytest.raises(CheckpointError, match="it lacks 'validation_score'"):
        HubNetwork.from_pretrained(folder).generate_model_card()


def test_agents_take_paths_first_then_models_of_the_hub(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    cached = tmp_path / "cache" / "models--ada--easy-dqn"
    (cached / "refs").mkdir(parents=True)
    (cached / "refs" / "main").write_text("0" * 40)
    (cached / "snapshots").mkdir()
    folder.rename(cached / "snapshots" / ("0" * 40))
    monkeypatch.chdir(tmp_path)
    downloaded = make_agent("pathqnet:ada/easy-dqn", "easy")
    (tmp_path / "ada").mkdir()
    (tmp_path / "ada" / "easy-dqn").write_bytes(shipped_network(get_task("easy")).read_bytes())
    assert make_agent("pathqnet:ada/easy-dqn", "easy").config != downloaded.config
    assert make_agent(f"pathqnet:{cached}/snapshots/{'0' * 40}", "easy").config == downloaded.config
    with pytest.raises(CheckpointError, match="ada/unknown is no file here, and the Hub does not give it: "):
        make_agent("ppo:ada/unknown", "easy")
    with pytest.raises(FileNotFoundError):
        make_agent("pathqnet:data/easy.safetensors", "easy")
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(MissingPackageError, match=r"huggingface_hub is not installed; run: .*\[hub\]"):
        make_agent("tournet:ada/tour", "easy")
