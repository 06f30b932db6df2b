"""Bodies, origins, the token, security headers, settings."""

import asyncio
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient
from starlette.types import Message
from starlette.websockets import WebSocketDisconnect

from drone_env.errors import InvalidValueError, text_of
from drone_env.server.app import create_app
from drone_env.server.exceptions import RequestError
from drone_env.server.json_bodies import LARGEST_BODY, JsonRequest, parse_json
from drone_env.server.settings import Settings, load_settings

JSON = {"Content-Type": "application/json"}


def app_with(tmp_path: Path, **settings: Any) -> TestClient:
    return TestClient(create_app(Settings(data=tmp_path, **settings)))


class TestBodies:
    @pytest.mark.parametrize("body", [b"{", b'{"agent": "\xff"}', rb'{"\ud800": 1}'])
    def test_what_is_not_json_is_refused(self, client: TestClient, body: bytes) -> None:
        answer = client.post("/reset", content=body, headers=JSON)
        assert (answer.status_code, answer.json()["code"]) == (400, "not_json")
        assert "not JSON: " in answer.json()["detail"]

    @pytest.mark.parametrize("declared", ["text/plain", "", None])
    def test_a_body_must_be_declared_as_json(self, client: TestClient, declared: str | None) -> None:
        headers = {} if declared is None else {"Content-Type": declared}
        answer = client.post("/reset", content=b'{"seed": 1}', headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (415, "content_type")
        headers = {"Content-Type": "Application/JSON; charset=utf-8"}
        assert client.post("/reset", content=b'{"seed": 1}', headers=headers).status_code == 200

    def test_every_route_limits_its_body(self, client: TestClient) -> None:
        paths = client.get("/openapi.json").json()["paths"]
        for path in [path for path, operation in paths.items() if "requestBody" in operation.get("post", {})]:
            refused = client.post(path, content=b"{}".ljust(LARGEST_BODY + 1), headers=JSON)
            assert (refused.status_code, refused.headers["Connection"]) == (413, "close")
            assert f"may have {LARGEST_BODY} bytes" in refused.json()["detail"]
            assert client.post(path, content=b"{}".ljust(LARGEST_BODY), headers=JSON).status_code != 413

    def test_a_body_that_comes_in_pieces_is_counted_whole(self) -> None:
        # The client above puts the pieces together itself.
        pieces = [b'{"agent": "', b"a" * 70_000, b"a" * 70_000, b'"}']

        async def receive() -> Message:
            piece = pieces.pop(0)
            return {"type": "http.request", "body": piece, "more_body": bool(pieces)}

        headers = [(b"transfer-encoding", b"chunked"), (b"content-type", b"application/json"), (b"host", b"localhost")]
        scope: dict[str, Any] = {"type": "http", "method": "POST", "path": "/reset", "headers": headers}
        with pytest.raises(RequestError, match="may have 131072 bytes"):
            asyncio.run(JsonRequest(scope, receive).read())


class TestJson:
    @pytest.mark.parametrize(
        ("text", "told"),
        [
            ("[Infinity]", "not JSON"),
            ('[{"a": 1, "b": 2, "a": 3}]', 'duplicate key "a"'),
            ("1" * 5000, "number out of range"),
            ("[" * 250 + "]" * 250, "recursion limit"),
            ('"\ud800"', "not JSON"),
        ],
    )
    def test_it_is_strict(self, text: str, told: str) -> None:
        with pytest.raises(InvalidValueError, match=told):
            parse_json(text.encode("utf-8", "surrogatepass"))

    @pytest.mark.parametrize(
        ("path", "body"),
        [
            ("/replay", {"actions": [12345] * 20_000}),
            ("/maps", {"cells": [["x"] * 128] * 120}),
        ],
    )
    def test_long_lists_have_few_validation_errors(
        self, shared_client: TestClient, monkeypatch: pytest.MonkeyPatch, path: str, body: dict[str, Any]
    ) -> None:
        """Each costs as much as parsing 500 bytes."""
        counts: list[int] = []

        def counted(error: Any) -> str:
            counts.append(len(error.errors()))
            return text_of(error)

        monkeypatch.setattr("drone_env.server.exceptions.text_of", counted)
        assert shared_client.post(path, json=body).status_code == 422
        assert 0 < counts[0] <= 600


def test_pages_of_this_server_may_call_and_no_others(tmp_path: Path) -> None:
    with app_with(tmp_path) as client:
        for origin in ("http://testserver", "https://testserver"):
            answer = client.post("/reset", headers={"Origin": origin})
            assert answer.status_code == 200
            assert "Access-Control-Allow-Origin" not in answer.headers
            with client.websocket_connect("/ws", headers={"Origin": origin}) as socket:
                socket.send_json({"type": "reset"})
                assert socket.receive_json()["type"] == "observation"
        foreign = ("http://page.example", "http://testserver.evil", "http://testserver:8001", "http://evil/testserver")
        for origin in (*foreign, "null", ""):
            assert client.post("/reset", headers={"Origin": origin}).status_code == 403
            with pytest.raises(WebSocketDisconnect), client.websocket_connect("/ws", headers={"Origin": origin}):
                pass


class TestToken:
    def test_all_but_the_health_and_the_page_asks_for_it(self, tmp_path: Path) -> None:
        with app_with(tmp_path, token="secret") as client:
            for path in ("/health", "/", "/static/js/main.js"):
                assert client.get(path).status_code == 200
            beside = ("/static/js/../../tasks", "/static/../tasks", "/staticx")
            for path in ("/docs", "/openapi.json", "/tasks", "/terminal_logs", "/nowhere", *beside):
                for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": "secret"}):
                    answer = client.get(path, headers=headers)
                    assert (answer.status_code, answer.headers["WWW-Authenticate"]) == (401, "Bearer")
            assert client.get("/tasks", headers={"Authorization": "bearer secret"}).status_code == 200
            right = {"Authorization": "Bearer secret"}
            assert client.post("/reset", headers=right).status_code == 200
            with pytest.raises(WebSocketDisconnect), client.websocket_connect("/ws"):
                pass
            with client.websocket_connect("/ws", headers=right) as socket:
                socket.send_json({"type": "reset"})
                assert socket.receive_json()["type"] == "observation"

    def test_it_is_not_shown(self) -> None:
        assert "secret" not in repr(Settings(token="secret"))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("path", ["/nowhere", "/"])
def test_every_answer_limits_what_browsers_do_with_it(client: TestClient, path: str) -> None:
    headers = client.get(path).headers
    policy, _, framing = headers["Content-Security-Policy"].partition("frame-ancestors ")
    assert policy.startswith("default-src 'self';")
    assert framing.startswith("'self' https://huggingface.co https://*.hf.space")
    assert "unsafe" not in policy + framing
    assert "http" not in policy
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert headers["Cache-Control"] == ("no-cache" if path == "/" else "no-store")
    assert "X-Frame-Options" not in headers


def test_an_unforeseen_failure_tells_no_trace(tmp_path: Path) -> None:
    app = create_app(Settings(data=tmp_path))

    @app.get("/broken")
    def broken() -> None:
        raise ZeroDivisionError("secret detail")

    with TestClient(app, raise_server_exceptions=False) as client:
        answer = client.get("/broken")
    assert answer.status_code == 500
    assert answer.json() == {"code": "internal", "detail": "the server failed; its log says why"}


class TestSettings:
    def test_they_come_from_the_environment(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("DRONE_ENV_PORT", "9000")
        monkeypatch.setenv("DRONE_ENV_HOST", "")
        settings = load_settings()
        assert (settings.port, settings.token, settings.host) == (9000, None, "127.0.0.1")

    @pytest.mark.parametrize(
        ("name", "value"),
        [("PORT", "many"), ("IDLE_SECONDS", "-1"), ("TOKEN", "")],
    )
    def test_a_wrong_value_is_named(self, monkeypatch: pytest.MonkeyPatch, name: str, value: str) -> None:
        monkeypatch.setenv(f"DRONE_ENV_{name}", value)
        with pytest.raises(InvalidValueError, match=f"DRONE_ENV_{name}: "):
            load_settings()
