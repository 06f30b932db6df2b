"""`drone-env doctor` on a sound machine and on broken ones."""

import shutil
from importlib import metadata
from pathlib import Path

import pytest

from drone_env.agents.pathqnet import WEIGHTS
from drone_env.cli import main
from drone_env.errors import install_command


@pytest.fixture(autouse=True)
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with nothing in it."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def diagnosis(capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, list[str]]]:
    """The exit status, and the status and detail of each finding by its name."""
    status = main(["doctor"])
    found, _, verdict = capsys.readouterr().out.rpartition("\n\n")
    assert verdict.startswith("Broken: ") == (status == 1)
    return status, {name: rest for _, name, *rest in (line.split(maxsplit=3) for line in found.splitlines())}


def test_a_sound_machine(capsys: pytest.CaptureFixture[str], empty_folder: Path) -> None:
    status, found = diagnosis(capsys)
    assert status == 0
    for name in ("python", "required", "pathqnet", "ppo", "tournet", "data", "cache"):
        assert found[name][0] == "ok", found[name]
    assert found["data"][1] == str(empty_folder / "data")
    assert list(empty_folder.iterdir()) == []


def test_what_is_broken(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, empty_folder: Path
) -> None:
    weights = tmp_path / "weights"
    shutil.copytree(WEIGHTS, weights)
    monkeypatch.setattr("drone_env.agents.pathqnet.WEIGHTS", weights)
    monkeypatch.setattr("drone_env.agents.tournet.SHIPPED", tmp_path / "gone.safetensors")
    file = weights / "easy_delivery_v1.safetensors"
    file.write_bytes(file.read_bytes()[:100_000])
    (empty_folder / "file").write_text("")
    monkeypatch.setenv("DRONE_ENV_DATA", "file/data")
    (empty_folder / "half_a_plugin.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(str(empty_folder))
    monkeypatch.setenv("DRONE_ENV_PLUGINS", "half_a_plugin,tests.toy")
    ended, found = diagnosis(capsys)
    broken = {name: detail for name, (status, detail) in found.items() if status == "broken"}
    assert (ended, set(broken)) == (1, {"pathqnet", "tournet", "data", "results", "half_a_plugin"})
    assert "gone.safetensors" in broken["tournet"]
    assert "division by zero" in broken["half_a_plugin"]


@pytest.mark.parametrize(("missing", "status", "broken"), [("rich", 1, {"required"}), ("fastapi", 0, set())])
def test_what_flying_needs_is_broken_if_missing_and_an_extra_is_absent(
    missing: str, status: int, broken: set[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = metadata.distributions
    monkeypatch.setattr(metadata, "distributions", lambda name: () if name == missing else installed(name=name))
    ended, found = diagnosis(capsys)
    assert (ended, {name for name in found if found[name][0] == "broken"}) == (status, broken)
    assert found["all"][0] == "absent"
    assert missing in found["all"][1]
    assert found["all"][1].endswith(f"run: {install_command('all')}")
