"""The cost of bodies and frames in validation errors, each of which costs as much as parsing 500 bytes."""

import json
from typing import Any

import pytest
from pydantic import ValidationError
from starlette.testclient import TestClient

from drone_env import errors
from tests.api.hostile_bodies import of_routes, of_sockets

MOST = 600


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The number of validation errors of each refusal."""
    numbers: list[int] = []
    original = errors.wrong_parts

    def wrong_parts(error: Any) -> Any:
        numbers.append(error.error_count() if isinstance(error, ValidationError) else len(error.errors()))
        return original(error)

    monkeypatch.setattr(errors, "wrong_parts", wrong_parts)
    return numbers


def test_no_body_has_many_validation_errors(shared_client: TestClient, counted: list[int]) -> None:
    headers = {"Content-Type": "application/json"}
    for path, bodies in of_routes(shared_client.get("/openapi.json").json()):
        for name, content in bodies:
            if not name.endswith(("list of 12345", "many keys", '\\ud800"')):
                continue
            answer = shared_client.post(path, content=content, headers=headers)
            assert answer.status_code < 500, (path, name, answer.text)
    assert 0 < max(counted) <= MOST


@pytest.mark.parametrize("path", ["/ws", "/mcp", "/live"])
def test_no_frame_has_many_validation_errors(shared_client: TestClient, counted: list[int], path: str) -> None:
    with shared_client.websocket_connect(path) as socket:
        for name, content in of_sockets()[path]:
            socket.send_text(content.decode())
            answer = json.loads(socket.receive_text())
            known = ("error", "observation", "state", "mcp")
            assert "jsonrpc" in answer if path == "/mcp" else answer["type"] in known, (name, answer)
            assert "the server failed" not in str(answer), name
    assert 0 < max(counted) <= MOST
