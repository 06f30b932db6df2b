"""MCP over HTTP and WebSocket: the session that a call flies, and calls that are invalid."""

import json
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from drone_env.planning.optimal import solve
from drone_env.server.app import create_app
from drone_env.server.openenv import LARGEST_FRAME
from drone_env.server.schemas import MAX_ROUTE
from drone_env.server.settings import Settings


def request(method: str, **params: Any) -> dict[str, Any]:
    return {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}


def post(client: TestClient, method: str, **params: Any) -> dict[str, Any]:
    return client.post("/mcp", json=request(method, **params)).json()


def opened(client: TestClient) -> str:
    return post(client, "openenv/session/create")["result"]["session_id"]


CALLS: list[dict[str, Any]] = [
    {},
    *({"name": name, "arguments": {}} for name in ("none", "fly", ["fly"], None, "x" * 5000)),
    *({"name": "fly", "arguments": arguments} for arguments in ([], {"route": "UP", "more": 1}, {"x": 1}, None)),
    *({"name": "fly", "arguments": {"route": route}} for route in (None, "SIDEWAYS", "", [], ["UP"] * (MAX_ROUTE + 1))),
    {"name": "look", "arguments": {"x": 1}},
    *({"name": "reset", "arguments": {"seed": seed}} for seed in (2**53, 1e9, "7", -1)),
    *({"name": "reset", "arguments": arguments} for arguments in ({"task_name": "none"}, {"prompt": "minimal"})),
]
WRONG: list[tuple[Any, int]] = [
    *((wrong, -32600) for wrong in ([], None, {"jsonrpc": "2.0"}, {"jsonrpc": 2, "method": "ping"})),
    ({"jsonrpc": "2.0", "method": ["ping"]}, -32600),
    *((request(method), -32601) for method in ("tools/none", "x" * 5000)),
    ({"jsonrpc": "2.0", "method": "tools/call", "params": []}, -32602),
    *((request("tools/call", **call), -32602) for call in CALLS),
]


@pytest.mark.parametrize(("wrong", "code"), WRONG)
def test_an_invalid_request_is_an_error_and_the_flight_goes_on(
    shared_client: TestClient, wrong: Any, code: int
) -> None:
    session = opened(shared_client)
    start, look = request("tools/call", name="reset", arguments={"seed": 7}), request("tools/call", name="look")
    headers = {"Mcp-Session-Id": session}
    over_http, over_socket = (list[Any](), list[Any]())
    with shared_client.websocket_connect("/mcp") as socket:
        for call in (start, look, wrong, look):
            over_http.append(shared_client.post("/mcp", json=call, headers=headers).json())
            socket.send_json(call)
            over_socket.append(socket.receive_json())
    assert over_http == over_socket
    assert over_http[1] == over_http[3]
    assert over_http[2]["error"]["code"] == code


@pytest.mark.parametrize("path", ["/mcp", "/ws"])
def test_a_call_before_the_first_reset_is_an_error(shared_client: TestClient, path: str) -> None:
    with shared_client.websocket_connect(path) as socket:
        for name, arguments in (("look", {}), ("fly", {"route": "UP"})):
            call = request("tools/call", name=name, arguments=arguments)
            socket.send_json(call if path == "/mcp" else {"type": "mcp", "data": call})
            answer = socket.receive_json()
            error = (answer if path == "/mcp" else answer["data"])["error"]
            assert (error["code"], error["message"]) == (-32603, "no episode yet: call reset() first")


def test_a_frame_that_is_not_json_is_an_error_and_a_large_one_closes(shared_client: TestClient) -> None:
    with shared_client.websocket_connect("/mcp") as socket:
        for text in ("", "{", '{"id": NaN}', "9" * 5000):
            socket.send_text(text)
            assert socket.receive_json()["error"]["code"] == -32700
        socket.send_bytes(b"{}")
        assert socket.receive_json()["error"]["code"] == -32700
        socket.send_text(json.dumps(request("ping")).ljust(LARGEST_FRAME + 1))
        with pytest.raises(WebSocketDisconnect) as closed:
            socket.receive_text()
    assert closed.value.code == 1009


def test_a_session_is_that_of_http_and_of_a_socket_until_it_is_closed(shared_client: TestClient) -> None:
    session = opened(shared_client)
    with shared_client.websocket_connect(f"/ws?session_id={session}") as socket:
        socket.send_json({"type": "reset", "data": {"task_name": "easy", "seed": 7, "episode_id": "mine"}})
        assert socket.receive_json()["type"] == "observation"
        assert shared_client.post("/step", json={"direction": "UP"}, headers={"X-Session-Id": session}).json()
        flown = post(shared_client, "tools/call", name="fly", arguments={"route": "DOWN"}, session_id=session)
        assert flown["result"]["data"]["flown"] == 1
        socket.send_json({"type": "state"})
        state = socket.receive_json()["data"]
        assert (state["episode_id"], state["step_count"], state["reward_profile"]) == ("mine", 2, "score")
        socket.send_json({"type": "reset", "data": {"seed": 7}})
        socket.receive_json()
        socket.send_json({"type": "step", "data": {"route": [int(action) for action in solve("easy", 7).actions]}})
        assert socket.receive_json()["data"]["done"]
        assert shared_client.get("/history/easy").json()
        closed = post(shared_client, "openenv/session/close", session_id=session)
        assert closed["result"] == {"session_id": session, "closed": True}
        socket.send_json({"type": "state"})
        assert socket.receive_json()["data"]["code"] == "EXECUTION_ERROR"
    assert shared_client.post("/mcp", json=request("none")).json()["error"]["code"] == -32601
    assert post(shared_client, "tools/call", name="look")["error"]["code"] == -32602
    for gone in (session, "none", "\ud800", "", 7):
        body = json.dumps(request("openenv/session/close", session_id=gone))
        answer = shared_client.post("/mcp", content=body, headers={"Content-Type": "application/json"})
        assert answer.status_code == 400 if gone == "\ud800" else answer.json()["error"]["code"] == -32602
    with shared_client.websocket_connect("/ws?session_id=none") as socket:
        assert socket.receive_json()["data"]["code"] == "SESSION_ERROR"


def test_without_room_no_session_is_opened(tmp_path: Path) -> None:
    with TestClient(create_app(Settings(data=tmp_path, capacity=1))) as client:
        assert "Mcp-Session-Id" in client.post("/mcp", json=request("initialize", protocolVersion=[1])).headers
        for method in ("openenv/session/create", "initialize"):
            refused = client.post("/mcp", json=request(method))
            assert refused.json()["error"]["code"] == -32000
            assert "Mcp-Session-Id" not in refused.headers
