"""OpenEnv's WebSocket: invalid frames, capacity, idle sockets, stored episodes."""

import asyncio
import json
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from pydantic_core import to_json
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from drone_env.core.episode import Episode
from drone_env.models import observation_fields
from drone_env.planning.optimal import solve
from drone_env.server.app import create_app
from drone_env.server.openenv import LARGEST_FRAME
from drone_env.server.schemas import MAX_ROUTE
from drone_env.server.settings import Settings
from tests.api.conftest import Clock
from tests.tools import PATIENCE


def socket_result(fields: dict[str, Any], reward: float | None, flown: int, profile: str) -> dict[str, Any]:
    """The response to a step: reward and done beside the rest."""
    metadata = {"reward_profile": profile, "flown": flown}
    observation = {name: value for name, value in fields.items() if name != "done"}
    observation |= {"metadata": metadata, "prompt": ""}
    return {"observation": observation, "reward": reward, "done": fields["done"], "metadata": metadata}


def ask(socket: WebSocketTestSession, frame: Any) -> Any:
    socket.send_text(frame if isinstance(frame, str) else json.dumps(frame))
    return json.loads(socket.receive_text())


@pytest.mark.parametrize(
    ("frame", "code"),
    [
        ("", "INVALID_JSON"),
        ('{"type": "reset", "data": {"seed": NaN}}', "INVALID_JSON"),
        ("[]", "VALIDATION_ERROR"),
        ({"type": "reset", "data": []}, "VALIDATION_ERROR"),
        ({"type": "reset", "data": {"colour": "red"}}, "VALIDATION_ERROR"),
        ({"type": "reset", "data": {"task_name": "none"}}, "VALIDATION_ERROR"),
        ({"type": "step", "data": {"direction": {"UP": 1}}}, "VALIDATION_ERROR"),
        ({"type": "step", "data": {"direction": "UP UP SIDEWAYS"}}, "VALIDATION_ERROR"),
        ({"type": "step", "data": {"direction": "UP " * (MAX_ROUTE + 1)}}, "VALIDATION_ERROR"),
        ({"type": "step", "data": {"direction": ["UP"]}}, "VALIDATION_ERROR"),
        ({"type": "step", "data": {"route": "UP"}}, "VALIDATION_ERROR"),
        ({"type": "step", "data": "UP"}, "VALIDATION_ERROR"),
        ({"type": "step", "data": {"direction": "<think>" * 900}}, "VALIDATION_ERROR"),
        ({"type": "reset", "data": {"prompt": "../prompts/minimal-2.toml"}}, "VALIDATION_ERROR"),
        ({"type": "\ud800"}, "INVALID_JSON"),
        ({"data": {}}, "UNKNOWN_TYPE"),
    ],
)
def test_a_frame_that_cannot_be_answered_is_an_error_and_the_session_goes_on(
    shared_client: TestClient, frame: Any, code: str
) -> None:
    with shared_client.websocket_connect("/ws") as socket:
        assert ask(socket, {"type": "state"})["data"]["code"] == "EXECUTION_ERROR"
        ask(socket, {"type": "reset", "data": {"seed": 7}})
        ask(socket, {"type": "step", "data": {"direction": "UP"}})
        before = ask(socket, {"type": "state"})
        answer = ask(socket, frame)
        assert (answer["type"], answer["data"]["code"]) == ("error", code)
        assert answer["data"]["message"]
        assert ask(socket, {"type": "state"}) == before


@pytest.mark.parametrize("frame", ['{"type": "reset"}'.ljust(LARGEST_FRAME + 1), "🚁" * (LARGEST_FRAME // 4 + 1)])
def test_a_large_frame_closes(shared_client: TestClient, frame: str) -> None:
    with shared_client.websocket_connect("/ws") as socket:
        assert ask(socket, '{"type": "reset"}'.ljust(LARGEST_FRAME))["type"] == "observation"
        route = {"type": "step", "data": {"direction": "RIGHT " * MAX_ROUTE}}
        assert ask(socket, json.dumps(route))["type"] == "observation"
        assert ask(socket, "🚁" * (LARGEST_FRAME // 4))["data"]["code"] == "INVALID_JSON"
        socket.send_text(frame)
        with pytest.raises(WebSocketDisconnect) as closed:
            socket.receive_text()
    assert closed.value.code == 1009


def test_one_connection_more_than_there_is_room_for_is_told_so(tmp_path: Path) -> None:
    with (
        TestClient(create_app(Settings(data=tmp_path, capacity=1))) as client,
        client.websocket_connect("/ws") as first,
    ):
        ask(first, {"type": "reset"})
        with client.websocket_connect("/ws") as second:
            # Answered by a server that has let it in: no waiting for what never comes.
            second.send_json({"type": "state"})
            assert second.receive_json()["data"]["code"] == "CAPACITY_REACHED"
            with pytest.raises(WebSocketDisconnect) as closed:
                second.receive_text()
        assert closed.value.code == 1013
        assert ask(first, {"type": "state"})["type"] == "state"


def test_an_address_opens_as_many_sockets_as_are_free_for_others(tmp_path: Path) -> None:
    app = create_app(Settings(data=tmp_path, capacity=4))

    def opens(client: TestClient) -> bool:
        socket = opened.enter_context(client.websocket_connect("/ws"))
        socket.send_json({"type": "state"})
        try:
            return "CAPACITY_REACHED" not in socket.receive_text()
        except WebSocketDisconnect:
            return False

    with TestClient(app, client=("192.0.2.1", 1)) as one, ExitStack() as opened:
        another = TestClient(app, client=("192.0.2.2", 1))
        another.portal = one.portal
        clients = [one, one, one, another, another, another]
        assert [opens(client) for client in clients] == [True, True, False, True, False, False]


def test_an_idle_socket_is_closed_and_its_place_is_free(tmp_path: Path, clock: Clock) -> None:
    # Looked for every 0.1 s; idle by the test's clock alone.
    app = create_app(Settings(data=tmp_path, capacity=1, idle_seconds=0.4), clock)
    with TestClient(app) as client:
        for _ in range(2):
            with client.websocket_connect("/ws") as socket:
                assert ask(socket, {"type": "reset"})["type"] == "observation"
                clock.now += 0.3
                assert ask(socket, {"type": "state"})["type"] == "state"
                clock.now += 0.3
                assert ask(socket, {"type": "state"})["type"] == "state"
                clock.now += 1
                with pytest.raises(WebSocketDisconnect) as closed:
                    socket.receive_text()
            assert closed.value.code == 1001
            assert not app.state.socket.touched


def test_whoever_sends_without_end_leaves_others_their_turn(tmp_path: Path) -> None:
    frames = iter([{"type": "websocket.connect"}, *[{"type": "websocket.receive", "text": '{"type":"none"}'}] * 200])
    turns, answers = 0, 0

    async def receive() -> Any:
        return next(frames, {"type": "websocket.disconnect", "code": 1000})

    async def send(message: Any) -> None:
        nonlocal answers
        answers += message["type"] == "websocket.send"

    async def fly() -> None:
        nonlocal turns
        socket = create_app(Settings(data=tmp_path)).state.socket
        served = asyncio.create_task(socket({"type": "websocket", "query_string": b""}, receive, send))
        while not served.done():
            await asyncio.sleep(0)
            turns += 1

    asyncio.run(asyncio.wait_for(fly(), PATIENCE))
    assert answers == 200
    assert turns >= 200


@pytest.mark.parametrize("route", ["UP", "UP up WAIT", "[UP, UP, WAIT]"])
def test_an_action_is_a_word_or_a_route(shared_client: TestClient, route: str) -> None:
    episode = Episode("easy", "tiered", 7)
    rewards = [episode.step(one) for one in ([0] if route == "UP" else [0, 0, 4])]
    with shared_client.websocket_connect("/ws") as socket:
        ask(socket, {"type": "reset", "data": {"seed": 7, "reward_profile": "tiered"}})
        answer = ask(socket, {"type": "step", "data": {"direction": route}})
    expected = socket_result(observation_fields(episode), sum(rewards), len(rewards), "tiered")
    assert answer["data"] == json.loads(to_json(expected))


def test_a_route_that_goes_on_after_the_end_is_flown_to_the_end(shared_client: TestClient) -> None:
    best = solve("easy", 7)
    route = {
        "type": "step",
        "data": {"direction": " ".join([*(action.name for action in best.actions), "WAIT", "WAIT"])},
    }
    with shared_client.websocket_connect("/ws") as socket:
        assert ask(socket, {"type": "reset", "data": {"seed": 7}})["data"]["metadata"] == {"reward_profile": "score"}
        answer = ask(socket, route)["data"]
        assert (answer["done"], answer["reward"], answer["metadata"]["flown"]) == (True, best.score, best.steps)
        again = ask(socket, route)["data"]
        assert (again["done"], again["reward"], again["metadata"]["flown"]) == (True, 0, 0)
        assert "the episode has ended" in again["observation"]["message"]
    kept = shared_client.get("/memory_logs").json()["episodes"][0]
    assert (kept["seed"], kept["reward_total"], kept["outcome"]) == (7, best.score, "delivered")
