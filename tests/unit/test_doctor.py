"""`drone-env doctor`: what it says of a sound machine, and of each way in which one is not."""

import json
import shutil
import socket
from pathlib import Path
from typing import Any

import pytest

from drone_env import __version__
from drone_env.agents.pathqnet import WEIGHTS
from drone_env.cli import main
from drone_env.commands import doctor
from drone_env.errors import MissingPackageError
from tests.tools import reserved_port

SECRET = "hf_do_not_print_me"


@pytest.fixture(autouse=True)
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder with nothing in it."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def diagnosis(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, dict[str, dict[str, Any]]]:
    """The exit status, and the findings by their names."""
    status = main(["doctor", "--port", "0", *arguments, "--json"])
    report = json.loads(capsys.readouterr().out)
    assert report["version"] == __version__
    assert report["healthy"] == (status == 0)
    return status, {finding["name"]: finding for finding in report["findings"]}


def test_a_sound_machine(capsys: pytest.CaptureFixture[str], empty_folder: Path) -> None:
    status, found = diagnosis(capsys)
    assert status == 0
    for name in ("python", "numpy", "numba", "easy_delivery", "medium_delivery", "hard_delivery", "data", "cache"):
        assert found[name]["status"] == "ok", found[name]
    assert found["data"]["detail"].startswith(f"{empty_folder / 'data'}, made when needed")
    assert list(empty_folder.iterdir()) == []


def test_a_folder_that_cannot_be_written(capsys: pytest.CaptureFixture[str], empty_folder: Path) -> None:
    (empty_folder / "file").write_text("")
    status, found = diagnosis(capsys, "--data", "file/data")
    assert (status, found["data"]["status"]) == (1, "broken")
    assert str(empty_folder / "file" / "data") in found["data"]["detail"]


@pytest.mark.parametrize("port", [-1, 65536])
def test_a_port_that_is_none(port: int, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = diagnosis(capsys, "--port", str(port))
    finding = found[f"127.0.0.1:{port}"]
    assert (status, finding["status"], finding["detail"]) == (0, "attention", "a port is 0 to 65535")


def test_a_port_that_is_taken_is_no_defect(capsys: pytest.CaptureFixture[str]) -> None:
    port = reserved_port()
    name = f"127.0.0.1:{port}"
    assert diagnosis(capsys, "--port", str(port))[1][name]["detail"] == "free"
    with socket.create_server(("127.0.0.1", port)):
        status, found = diagnosis(capsys, "--port", str(port))
    assert (status, found[name]["status"], found[name]["detail"][:5]) == (0, "attention", "taken")


@pytest.mark.parametrize(
    ("name", "harm"),
    [
        ("medium_delivery", "cut short"),
        ("tournet", "missing"),
    ],
)
def test_a_network_that_is_not_whole(
    name: str, harm: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    weights = tmp_path / "weights"
    shutil.copytree(WEIGHTS, weights)
    monkeypatch.setattr("drone_env.agents.pathqnet.WEIGHTS", weights)
    monkeypatch.setattr("drone_env.agents.tournet.SHIPPED", weights / "tournet_v1.safetensors")
    file = weights / f"{name}_v1.safetensors"
    if harm == "missing":
        file.unlink()
    else:
        file.write_bytes(file.read_bytes()[:100_000])
    status, found = diagnosis(capsys)
    assert (status, found[name]["status"]) == (1, "broken")
    others = {"tournet", "medium_delivery", "hard_delivery"} - {name}
    assert {found[other]["status"] for other in others} == {"ok"}


def test_settings_that_are_wrong_or_misspelt(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, empty_folder: Path
) -> None:
    monkeypatch.setenv("DRONE_ENV_TOKN", SECRET)
    status, found = diagnosis(capsys)
    assert status == 0
    assert found["DRONE_ENV_TOKN"]["status"] == "attention"
    assert "DRONE_ENV_TOKEN" in found["DRONE_ENV_TOKN"]["detail"]
    assert "HF_TOKEN" in found["llm"]["detail"]

    monkeypatch.setenv("DRONE_ENV_WORKERS", "many")
    status, found = diagnosis(capsys)
    assert (status, found["server"]["status"]) == (1, "broken")
    assert "DRONE_ENV_WORKERS" in found["server"]["detail"]


@pytest.mark.parametrize("url", ["https://router.huggingface.co/v1", f"http://me:{SECRET}@127.0.0.1:none/v1"])
def test_no_secret_is_printed(
    url: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, empty_folder: Path
) -> None:
    monkeypatch.setenv("DRONE_ENV_TOKEN", f"{SECRET} 1")
    monkeypatch.setenv("HF_TOKEN", SECRET)
    monkeypatch.setenv("API_BASE_URL", url)
    (empty_folder / ".env").write_text(f"OPENAI_API_KEY={SECRET}\n")
    for arguments in (["--json"], []):
        assert main(["doctor", "--port", "0", *arguments]) == 0
        captured = capsys.readouterr()
        assert "settings" in captured.out
        assert arguments or captured.out.rstrip().endswith("Flights can be flown.")
        assert SECRET not in captured.out + captured.err


@pytest.mark.parametrize(
    ("missing", "status", "broken"), [("rich", 1, {"required"}), ("fastapi", 0, set()), ("torch", 0, set())]
)
def test_what_flying_needs_is_broken_if_missing_and_an_extra_is_absent(
    missing: str, status: int, broken: set[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    version = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == missing else version(name))
    ended, found = diagnosis(capsys)
    assert (ended, {name for name in found if found[name]["status"] == "broken"}) == (status, broken)
    assert found["all"]["status"] == "absent"
    assert missing in found["all"]["detail"]
    command = found["all"]["detail"].partition(" brings ")[0]
    assert command in str(MissingPackageError(missing, "all"))


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
    assert found["hard_delivery"]["status"] == "ok"
