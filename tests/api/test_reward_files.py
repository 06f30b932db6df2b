"""Reward profiles from files that the server was started with."""

from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.cli import main


@pytest.fixture
def settings(tmp_path: Path) -> dict[str, Any]:
    mine = tmp_path / "mine.toml"
    mine.write_text('id = "mine"\nsummary = "waiting pays"\n[events]\nwait = 0.25\n')
    return {"data": tmp_path / "data", "reward_profiles": str(mine)}


def test_callers_find_the_profile_and_are_paid_by_it(client: TestClient, tmp_path: Path) -> None:
    told = client.get("/tasks").json()
    assert told["tasks"][0]["rewards"]["mine"]["wait"] == [0.25]
    opened = client.post("/reset", json={"seed": 7, "reward_profile": "mine"})
    session = {"X-Session-Id": opened.json()["session_id"]}
    assert client.post("/step", json={"direction": "WAIT"}, headers=session).json()["reward_last"] == 0.25
    refused = client.post("/reset", json={"seed": 7, "reward_profile": str(tmp_path / "mine.toml")})
    assert refused.status_code == 422, "no caller may have the server read a file"
    assert "allowed: aligned" in refused.text


@pytest.mark.parametrize("text", [None, "id = 'aligned'"])
def test_a_file_that_is_no_profile_is_said_before_the_server_starts(
    text: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("PORT", "DATA", "REWARD_PROFILES"):
        monkeypatch.setenv(f"DRONE_ENV_{name}", "")  # which the command sets for its workers
    path = tmp_path / "mine.toml"
    if text is not None:
        path.write_text(text)
    assert main(["serve", "--port", "0", "--data", str(tmp_path / "data"), "--reward-profiles", str(path)]) == 2
    assert str(path) in capsys.readouterr().err
    assert not (tmp_path / "data").exists()
