"""MCP over HTTP: the session that a call flies, and calls that are invalid."""

import json
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.planning.optimal import solve
from drone_env.server.app import create_app
from drone_env.server.schemas import MAX_ROUTE
from drone_env.server.settings import Settings


def request(method: str, **params: Any) -> dict[str, Any]:
    return {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}


def post(client: TestClient, method: str, **params: Any) -> dict[str, Any]:
    return client.post("/mcp", json=request(method, **params)).json()


def opened(client: TestClient) -> str:
    return post(client, "openenv/session/create")["result"]["session_id"]


NO_TOOLS: list[dict[str, Any]] = [
    {},
    *({"name": name, "arguments": {}} for name in ("none", ["fly"])),
]
CALLS: list[dict[str, Any]] = [
    {"name": "fly"},
    *({"name": "fly", "arguments": arguments} for arguments in ([], {}, {"route": "UP", "more": 1})),
    *({"name": "fly", "arguments": {"route": route}} for route in (None, "SIDEWAYS", ["UP"] * (MAX_ROUTE + 1))),
    {"name": "look", "arguments": {"x": 1}},
    *({"name": "reset", "arguments": {"seed": seed}} for seed in (2**53, "7")),
    *({"name": "reset", "arguments": arguments} for arguments in ({"task_name": "none"}, {"prompt": "minimal"})),
]
WRONG: list[tuple[Any, int]] = [
    *((wrong, -32600) for wrong in ([], None, {"jsonrpc": "2.0"}, {"jsonrpc": 2, "method": "ping"})),
    ({"jsonrpc": "2.0", "method": ["ping"]}, -32600),
    *((request(method), -32601) for method in ("tools/none",)),
    ({"jsonrpc": "2.0", "method": "tools/call", "params": []}, -32602),
    *((request("tools/call", **call), -32602) for call in (*NO_TOOLS, *CALLS)),
]


@pytest.mark.parametrize(("wrong", "code"), WRONG)
def test_an_invalid_request_is_an_error_and_the_flight_goes_on(
    shared_client: TestClient, wrong: Any, code: int
) -> None:
    start, look = request("tools/call", name="reset", arguments={"seed": 7}), request("tools/call", name="look")
    headers = {"Mcp-Session-Id": opened(shared_client)}
    answers = [shared_client.post("/mcp", json=call, headers=headers).json() for call in (start, look, wrong, look)]
    if wrong in [request("tools/call", **call) for call in CALLS]:
        # For a client of MCP it is a result, which a model reads; for OpenEnv's, which name the session, an error.
        assert answers[2]["result"]["isError"]
        wrong["params"]["session_id"] = headers["Mcp-Session-Id"]
        answers[2] = shared_client.post("/mcp", json=wrong).json()
    assert answers[2]["error"]["code"] == code
    assert answers[1] == answers[3]


def test_a_call_before_the_first_reset_is_an_error(shared_client: TestClient) -> None:
    with shared_client.websocket_connect("/ws") as socket:
        for name, arguments in (("look", {}), ("fly", {"route": "UP"})):
            call = {"type": "call_tool", "tool_name": name, "arguments": arguments}
            socket.send_json({"type": "step", "data": call})
            error = socket.receive_json()["data"]["observation"]["error"]
            assert error == {"error_type": "execution_error", "message": "no episode yet: call reset() first"}


def test_a_session_is_that_of_http_until_it_is_closed(shared_client: TestClient) -> None:
    session = opened(shared_client)
    named = {"X-Session-Id": session}

    def call(tool: str, **arguments: Any) -> dict[str, Any]:
        return post(shared_client, "tools/call", name=tool, arguments=arguments, session_id=session)["result"]["data"]

    call("reset", task_name="easy", seed=7)
    assert shared_client.post("/step", json={"direction": "UP"}, headers=named).json()
    assert call("fly", route="DOWN")["flown"] == 1
    state = shared_client.get("/state", headers=named).json()
    assert (state["step_count"], state["reward_profile"]) == (2, "score")
    call("reset", seed=7)
    assert call("fly", route=" ".join(action.name for action in solve("easy", 7).actions))["done"]
    closed = post(shared_client, "openenv/session/close", session_id=session)
    assert closed["result"] == {"session_id": session, "closed": True}
    assert shared_client.get("/state", headers=named).status_code == 410
    for gone in (session, "none", "\ud800", "", 7):
        body = json.dumps(request("openenv/session/close", session_id=gone))
        answer = shared_client.post("/mcp", content=body, headers={"Content-Type": "application/json"})
        assert answer.status_code == 400 if gone == "\ud800" else answer.json()["error"]["code"] == -32602


LOOK = request("tools/call", name="look", arguments=None)


def headers(session: str | None = None, version: str | None = None) -> dict[str, str]:
    named = {"Mcp-Session-Id": session, "MCP-Protocol-Version": version}
    return {name: value for name, value in named.items() if value is not None}


@pytest.mark.parametrize(
    ("message", "version", "status"),
    [
        (LOOK, None, 200),
        (LOOK | {"id": "a"}, "2025-06-18", 200),
        ({"jsonrpc": "2.0", "id": 1, "method": "ping", "params": None}, "2025-03-26", 200),
        ({"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": 1}}, None, 202),
        ({"jsonrpc": "2.0", "id": 1, "error": {"code": -32601, "message": "no roots"}}, None, 202),
        (request("server/discover"), "2026-07-28", 400),
        (LOOK, "1999-01-01", 400),
    ],
)
def test_a_session_of_mcp_is_found_until_it_is_deleted(
    shared_client: TestClient, message: Any, version: str | None, status: int
) -> None:
    # Some clients start again with the session that is gone.
    begun = shared_client.post("/mcp", json=request("initialize"), headers=headers("gone"))
    named = headers(begun.headers["Mcp-Session-Id"], version)
    answer = shared_client.post("/mcp", json=message, headers=named)
    assert answer.status_code == status
    assert (answer.content == b"") == (status == 202)
    if status == 400:
        # A client of a newer version then tries `initialize`.
        assert answer.json()["error"]["code"] == -32600
        assert "2025-11-25, 2025-06-18" in answer.json()["error"]["message"]
        assert shared_client.delete("/mcp", headers=named).status_code == 400
        return
    assert shared_client.delete("/mcp", headers=named).status_code == 204
    for late in (
        shared_client.post("/mcp", json=message, headers=named),
        shared_client.delete("/mcp", headers=named),
        shared_client.post("/mcp", json=message, headers=headers("never")),
    ):
        assert (late.status_code, late.json()["error"]["code"]) == (404, -32001)


@pytest.mark.parametrize(
    ("asked", "version"),
    [("2025-06-18", "2025-06-18"), ("2024-11-05", "2024-11-05"), ("1999-01-01", "2025-11-25"), ([1], "2025-11-25")],
)
def test_the_version_is_negotiated(shared_client: TestClient, asked: Any, version: str) -> None:
    assert post(shared_client, "initialize", protocolVersion=asked)["result"]["protocolVersion"] == version


def test_a_call_without_a_session_and_a_stream_are_refused(shared_client: TestClient) -> None:
    answer = shared_client.post("/mcp", json=LOOK)
    assert (answer.status_code, answer.json()["error"]["code"]) == (400, -32602)
    assert "Mcp-Session-Id" in answer.json()["error"]["message"]
    assert shared_client.delete("/mcp").status_code == 400
    assert shared_client.post("/mcp/", json=request("ping"), follow_redirects=False).status_code == 200
    assert shared_client.get("/mcp", headers={"Accept": "text/event-stream"}).status_code == 405
    foreign = {"Origin": "https://elsewhere.example"}
    assert shared_client.post("/mcp", json=request("ping"), headers=foreign).status_code == 403


def test_a_session_without_steps_gives_way_to_a_new_one(tmp_path: Path) -> None:
    """Some clients of MCP initialize before every call, and delete nothing."""
    with TestClient(create_app(Settings(data=tmp_path, capacity=1))) as client:
        for _ in range(3):
            begun = client.post("/mcp", json=request("initialize")).headers["Mcp-Session-Id"]
        client.post("/mcp", json=request("tools/call", name="fly", arguments={"route": "UP"}), headers=headers(begun))
        for method in ("openenv/session/create", "initialize"):
            refused = client.post("/mcp", json=request(method))
            assert refused.json()["error"]["code"] == -32000
            assert "Mcp-Session-Id" not in refused.headers
