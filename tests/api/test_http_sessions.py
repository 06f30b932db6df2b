"""Sessions over HTTP: who is in which, when they end, and a store that fails under them."""

import shutil
import sqlite3
import threading
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.flights.store import FILE_NAME
from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from tests.unit.stores import failing

Header = dict[str, str]
NEW = {"X-Session-Id": "new"}
UP = {"direction": "UP"}


class TestSessions:
    def test_the_three_ways_to_be_told_a_session_agree(self, client: TestClient) -> None:
        answer = client.post("/reset")
        session = answer.json()["session_id"]
        assert answer.headers["X-Session-Id"] == session
        cookie = answer.headers["Set-Cookie"]
        assert cookie.startswith(f"drone_env_session={session};")
        assert "HttpOnly" in cookie
        assert "SameSite=lax" in cookie
        assert len(session) >= 32
        framed = client.post("https://testserver/reset").headers["Set-Cookie"]
        assert "Secure" in framed
        assert "SameSite=none" in framed

    @pytest.mark.parametrize(
        ("method", "path", "body"), [("POST", "/step", UP), ("GET", "/state", None), ("POST", "/predict", None)]
    )
    def test_without_a_session_one_is_told_what_to_do(
        self, client: TestClient, method: str, path: str, body: Any
    ) -> None:
        none = client.request(method, path, json=body)
        assert (none.status_code, none.json()["code"]) == (409, "no_session")
        for nothing in ({"X-Session-Id": ""}, {"Cookie": "drone_env_session="}):
            assert client.request(method, path, json=body, headers=nothing).status_code == 409
        gone = client.request(method, path, json=body, headers={"X-Session-Id": "never"})
        assert (gone.status_code, gone.json()["code"]) == (410, "session_gone")
        assert "POST /reset opens a session" in gone.json()["detail"]


def test_a_session_that_is_ended_is_gone_and_its_place_free(tmp_path: Path) -> None:
    with TestClient(create_app(Settings(data=tmp_path, capacity=1))) as client:
        header = {"X-Session-Id": client.post("/reset").json()["session_id"]}
        assert client.post("/step", json=UP, headers=header).status_code == 200
        full = client.post("/reset", headers=NEW)
        assert (full.status_code, full.json()["code"], full.headers["Retry-After"]) == (503, "no_room", "5")
        assert client.post("/reset", headers=header).status_code == 200
        assert client.delete("/session", headers=header).status_code == 204
        assert client.delete("/session", headers=header).status_code == 410
        assert client.get("/state", headers=header).status_code == 410
        client.cookies.clear()
        client.post("/reset")
        assert client.delete("/session").status_code == 204
        assert client.get("/state").json()["code"] == "no_session", "the cookie goes with it"
        answer = client.post("/reset", headers={"X-Session-Id": "never"})
        assert (answer.status_code, answer.json()["session_id"] == "never") == (200, False)


def test_a_store_that_fails_is_told_as_busy_and_keeps_nothing(
    client: TestClient, session: Header, settings: dict[str, Any]
) -> None:
    with failing(settings["data"], "UPDATE ON sessions"):
        for path, body in (("/step", UP), ("/reset", {"seed": 8})):
            answer = client.post(path, json=body, headers=session)
            assert (answer.status_code, answer.json()["code"]) == (503, "store")
            assert "the disk is gone" in answer.json()["detail"]
            assert answer.headers["Retry-After"] == "5"
        # The health check says so until something can be written again, which the server tries at times.
        sessions = client.app.state.shared.sessions  # pyright: ignore
        assert client.get("/health").status_code == 503
    sessions.expire()
    assert client.get("/health").status_code == 200
    state = client.get("/state", headers=session).json()
    assert (state["seed"], state["step_count"]) == (7, 0)
    # What was flown before the failure is not flown twice.
    assert client.post("/step", json={"direction": "UP"}, headers=session).json()["step_count"] == 1


def test_a_step_waits_for_another_process_in_its_own_thread(
    client: TestClient, session: Header, settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    waited: list[str] = []
    with closing(sqlite3.connect(settings["data"] / FILE_NAME, isolation_level=None, check_same_thread=False)) as other:

        def end_of_wait(_: float) -> None:
            waited.append(threading.current_thread().name)
            other.execute("ROLLBACK")

        monkeypatch.setattr("drone_env.flights.database.sleep", end_of_wait)
        other.execute("BEGIN IMMEDIATE")
        assert client.post("/step", json=UP, headers=session).json()["step_count"] == 1
    assert waited == ["drone_env-steps_0"]


def test_a_server_whose_files_are_gone_says_so_and_takes_no_step(
    client: TestClient, session: Header, settings: dict[str, Any]
) -> None:
    assert client.get("/health").status_code == 200
    assert client.post("/step", json=UP, headers=session).json()["step_count"] == 1
    shutil.rmtree(settings["data"])
    for method, path, body in (("GET", "/health", None), ("POST", "/step", UP), ("POST", "/reset", {})):
        answer = client.request(method, path, json=body, headers={} if path == "/reset" else session)
        assert (answer.status_code, answer.json()["code"], answer.headers["Retry-After"]) == (503, "store", "5")
        assert "deleted, moved or replaced while" in answer.json()["detail"]
    assert client.head("/health").status_code == 503
    assert client.get("/state", headers=session).json()["step_count"] == 1
