"""`drone-env doctor` on a sound machine and on broken ones."""

import json
import shutil
from importlib import metadata
from pathlib import Path
from typing import Any

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


def diagnosis(capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, dict[str, Any]]]:
    """The exit status, and the findings by their names."""
    status = main(["doctor", "--json"])
    report = json.loads(capsys.readouterr().out)
    assert report["healthy"] == (status == 0)
    return status, {finding["name"]: finding for finding in report["findings"]}


def test_a_sound_machine(capsys: pytest.CaptureFixture[str], empty_folder: Path) -> None:
    status, found = diagnosis(capsys)
    assert status == 0
    for name in ("python", "required", "easy_delivery", "hard_delivery", "tournet", "data", "cache"):
        assert found[name]["status"] == "ok", found[name]
    assert found["data"]["detail"] == str(empty_folder / "data")
    assert list(empty_folder.iterdir()) == []


def test_what_is_broken(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, empty_folder: Path
) -> None:
    weights = tmp_path / "weights"
    shutil.copytree(WEIGHTS, weights)
    monkeypatch.setattr("drone_env.agents.pathqnet.WEIGHTS", weights)
    monkeypatch.setattr("drone_env.agents.tournet.SHIPPED", tmp_path / "gone.safetensors")
    file = weights / "medium_delivery_v1.safetensors"
    file.write_bytes(file.read_bytes()[:100_000])
    (empty_folder / "file").write_text("")
    monkeypatch.setenv("DRONE_ENV_DATA", "file/data")
    status, found = diagnosis(capsys)
    broken = {name: finding["detail"] for name, finding in found.items() if finding["status"] == "broken"}
    assert (status, set(broken)) == (1, {"medium_delivery", "tournet", "data", "results"})
    assert "gone.safetensors: name a file, as in tournet:FILE" in broken["tournet"]


@pytest.mark.parametrize(("missing", "status", "broken"), [("rich", 1, {"required"}), ("fastapi", 0, set())])
def test_what_flying_needs_is_broken_if_missing_and_an_extra_is_absent(
    missing: str, status: int, broken: set[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = metadata.distributions
    monkeypatch.setattr(metadata, "distributions", lambda name: () if name == missing else installed(name=name))
    ended, found = diagnosis(capsys)
    assert (ended, {name for name in found if found[name]["status"] == "broken"}) == (status, broken)
    assert found["all"]["status"] == "absent"
    assert missing in found["all"]["detail"]
    assert found["all"]["detail"].endswith(f"run: {install_command('all')}")


def test_a_plugin_that_cannot_be_imported_is_broken(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, empty_folder: Path
) -> None:
    (empty_folder / "half_a_plugin.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(str(empty_folder))
    monkeypatch.setenv("DRONE_ENV_PLUGINS", "nope, half_a_plugin,tests.toy")
    status, found = diagnosis(capsys)
    assert status == 1
    assert [found[name]["status"] for name in ("nope", "half_a_plugin", "tests.toy")] == ["broken", "broken", "ok"]
    assert "No module named 'nope'" in found["nope"]["detail"]
    assert "division by zero" in found["half_a_plugin"]["detail"]
