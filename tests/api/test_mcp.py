"""MCP over HTTP and WebSocket: the session that a call flies, and calls that are invalid."""

import json
from typing import Any

import pytest
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from drone_env.planning.optimal import solve
from drone_env.server.json_routes import SMALL
from drone_env.server.schemas import MAX_ROUTE


def request(method: str, **params: Any) -> dict[str, Any]:
    return {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}


def post(client: TestClient, method: str, **params: Any) -> dict[str, Any]:
    return client.post("/mcp", json=request(method, **params)).json()


def opened(client: TestClient) -> str:
    return post(client, "openenv/session/create")["result"]["session_id"]


WRONG: list[tuple[Any, int]] = [
    ([], -32600),
    ({"jsonrpc": "2.0"}, -32600),
    ({"jsonrpc": 2, "method": "ping"}, -32600),
    ({"jsonrpc": "2.0", "method": ["ping"]}, -32600),
    (request("tools/none"), -32601),
    (request("x" * 5000), -32601),
    ({"jsonrpc": "2.0", "method": "tools/call", "params": []}, -32602),
    (request("tools/call"), -32602),
    (request("tools/call", name="none", arguments={}), -32602),
    (request("tools/call", name=["fly"], arguments={}), -32602),
    (request("tools/call", name="fly", arguments=[]), -32602),
    (request("tools/call", name="fly", arguments={}), -32602),
    (request("tools/call", name="fly", arguments={"route": "UP", "more": 1}), -32602),
    (request("tools/call", name="fly", arguments={"route": None}), -32602),
    (request("tools/call", name="fly", arguments={"route": "SIDEWAYS"}), -32602),
    (request("tools/call", name="fly", arguments={"route": []}), -32602),
    (request("tools/call", name="fly", arguments={"route": ["UP"] * (MAX_ROUTE + 1)}), -32602),
    (request("tools/call", name="look", arguments={"x": 1}), -32602),
    (request("tools/call", name="reset", arguments={"task_name": "none"}), -32602),
    (request("tools/call", name="reset", arguments={"seed": 2**53}), -32602),
    (request("tools/call", name="reset", arguments={"seed": 1e9}), -32602),
    (request("tools/call", name="reset", arguments={"prompt": "minimal"}), -32602),
]


@pytest.mark.parametrize(("wrong", "code"), WRONG)
def test_an_invalid_request_is_an_error_and_the_flight_goes_on(
    shared_client: TestClient, wrong: Any, code: int
) -> None:
    session = opened(shared_client)
    post(shared_client, "tools/call", name="reset", arguments={"seed": 7}, session_id=session)
    before = post(shared_client, "tools/call", name="look", session_id=session)
    headers = {"Mcp-Session-Id": session}
    answer = shared_client.post("/mcp", json=wrong, headers=headers)
    assert (answer.status_code, answer.json()["error"]["code"]) == (200, code)
    with shared_client.websocket_connect("/mcp") as socket:
        socket.send_json(request("tools/call", name="reset", arguments={"seed": 7}))
        assert socket.receive_json() == post(
            shared_client, "tools/call", name="reset", arguments={"seed": 7}, session_id=session
        )
        socket.send_json(wrong)
        assert socket.receive_json()["error"] == answer.json()["error"]
        socket.send_json(request("tools/call", name="look"))
        assert socket.receive_json() == before
    assert post(shared_client, "tools/call", name="look", session_id=session) == before


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
        socket.send_text(json.dumps(request("ping")).ljust(SMALL + 1))
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
    for gone in (session, "none", "\ud800", "", 7):
        body = json.dumps(request("openenv/session/close", session_id=gone))
        answer = shared_client.post("/mcp", content=body, headers={"Content-Type": "application/json"})
        assert answer.status_code == 400 if gone == "\ud800" else answer.json()["error"]["code"] == -32602
    with shared_client.websocket_connect("/ws?session_id=none") as socket:
        assert socket.receive_json()["data"]["code"] == "SESSION_ERROR"


def test_initialize_opens_a_session_that_a_header_names(shared_client: TestClient) -> None:
    answer = shared_client.post("/mcp", json=request("initialize", protocolVersion="1999-01-01"))
    assert answer.json()["result"]["protocolVersion"] == "2025-11-25"
    notified = shared_client.post("/mcp", json={"jsonrpc": "2.0", "method": "notifications/initialized"})
    assert (notified.status_code, notified.content) == (202, b"")
    headers = {"Mcp-Session-Id": answer.headers["Mcp-Session-Id"]}
    looked = shared_client.post("/mcp", json=request("tools/call", name="look"), headers=headers).json()
    assert looked["result"]["content"][0]["text"] == looked["result"]["structuredContent"]["text"]


@pytest.mark.parametrize("settings", [{"capacity": 1}])
def test_without_room_no_session_is_opened(settings: dict[str, Any], tmp_path: Any) -> None:
    from drone_env.server.app import create_app
    from drone_env.server.settings import Settings

    with TestClient(create_app(Settings(data=tmp_path, **settings))) as client:
        opened(client)
        assert post(client, "openenv/session/create")["error"]["code"] == -32000
        refused = client.post("/mcp", json=request("initialize"))
        assert refused.json()["error"]["code"] == -32000
        assert "Mcp-Session-Id" not in refused.headers
