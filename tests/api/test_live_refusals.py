"""The WebSocket of the page: what is refused, what fails, and who is let in."""

import base64
import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from drone_env.server.app import create_app
from drone_env.server.json_routes import SMALL
from drone_env.server.live.commands import MOST_EPISODES
from drone_env.server.live.episodes import LiveEpisode
from drone_env.server.settings import Settings
from tests.api.live_page import Page, open_page


def forking(pilot: str, **fork: Any) -> Any:
    fork = {"actions": ["WAIT"], "step": 1, "of": {"pilot": "greedy"}, **fork}
    return {"type": "start", "task": "easy", "seed": 7, "pilots": ["random", pilot], "fork": fork}


@pytest.mark.parametrize(
    ("frame", "told"),
    [
        ("", "invalid_request"),
        ('{"type": "pause"}' + " " * SMALL, "invalid_request"),
        ({"type": "start", "task": "easy", "pilots": ["greedy"] * (MOST_EPISODES + 1)}, "invalid_request"),
        ({"type": "start", "task": "easy", "pilots": ["ghost"]}, "unknown_name"),
        ({"type": "start", "task": "skyline_easy", "pilots": ["greedy", "pathqnet"]}, "unsupported"),
        ({"type": "attach", "sessions": ["nobody"]}, "session_gone"),
        ({"type": "fly", "direction": "UP"}, "wrong_moment"),
        ({"type": "undo", "flight": 3}, "unknown_name"),
        ({"type": "help"}, "wrong_moment"),
        ({"type": "play", "speed": 1e9}, "invalid_request"),
        (forking("human", of={"pilot": "a\nb"}), "one printable line of 1 to 200 characters"),
        (forking("human", actions=["WAIT"] * 61), "ends after 60 steps, but there are 61 actions"),
        (forking("greedy"), "not an action of greedy"),
    ],
)
def test_what_cannot_be_obeyed_is_told_and_changes_nothing(shared_client: TestClient, frame: Any, told: str) -> None:
    with open_page(shared_client) as page:
        (shown,) = page.start("greedy")
        page.until("values")
        sessions = shared_client.app.state.shared.sessions  # type: ignore[attr-defined]
        opened = sessions.count()
        page.socket.send_text(frame if isinstance(frame, str) else json.dumps(frame))
        message = page.until("error")
        assert message["detail"]
        assert told in f"{message['code']}: {message['detail']}"
        assert sessions.count() == opened
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["step"] == 1
        state = shared_client.get("/state", headers={"X-Session-Id": shown["opening"]["session"]}).json()
        assert state["step_count"] == 1


def test_a_page_is_told_once_that_a_map_could_not_be_solved_and_flies_on(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as today, open_page(client) as page:
        today.setattr("drone_env.server.live.episodes.values_along", failing)
        (shown,) = page.start("greedy")
        assert page.until("error")["code"] == "internal"
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["value"] is None
    with open_page(client) as page:
        page.send("attach", sessions=[shown["opening"]["session"]])
        assert len(page.until("flights")["flights"][0]["frames"]) == 2
        assert len(page.until("values")["values"]) == 2


def failing(*_: object) -> None:
    """A job that fails."""
    raise KeyError("a fault")


def test_what_nobody_foresaw_ends_no_connection(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with open_page(client) as page:
        page.start("greedy")
        page.until("values")
        with monkeypatch.context() as today:
            today.setattr(LiveEpisode, "step", lambda _: {}["a fault"])
            page.send("step")
            message = page.until("error")
            assert (message["code"], message["detail"]) == ("internal", "the server failed; its log says why")
        assert "KeyError: 'a fault'" in caplog.text
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["step"] == 1


def test_news_of_the_server(client: TestClient, settings: dict[str, Any]) -> None:
    with open_page(client) as page:
        client.get("/health")
        page.send("subscribe", topics=["requests", "training", "episodes"])
        assert [request["path"] for request in page.until("requests")["requests"]] == ["/health"]
        assert page.until("training")["lines"] == []
        assert page.until("episodes")["episodes"] == []
        (settings["data"] / "train.log").write_text("<b>episode 1</b>\nepisode=2 score=0.5\n")
        training = page.until("training")
        assert training["lines"] == ["<b>episode 1</b>", "episode=2 score=0.5"]
        assert training["curve"] == {"episode": [2], "score": [0.5]}
        for agent in ("<i>me</i>", "another"):
            header = {"X-Session-Id": client.post("/reset", json={"seed": 7, "agent": agent}).json()["session_id"]}
            observation = {"done": False}
            while not observation["done"]:
                observation = client.post("/step", headers=header, json={"direction": "WAIT"}).json()
            # What was told before is not told again.
            (episode,) = page.until("episodes")["episodes"]
            assert episode["agent"] == agent
        assert episode["regret"] == episode["optimal_score"] - episode["score"]


def test_the_page_is_open_and_offers_the_token_as_a_subprotocol(tmp_path: Path) -> None:
    with TestClient(create_app(Settings(data=tmp_path, token=SecretStr("s3cret/+?")))) as client:
        offered = base64.urlsafe_b64encode(b"s3cret/+?").decode().rstrip("=")
        with client.websocket_connect("/live", subprotocols=["drone-env", f"bearer.{offered}"]) as socket:
            assert socket.accepted_subprotocol == "drone-env"
            assert Page(socket).start("greedy")
        wrong = ["drone-env", "bearer.d3Jvbmc"]
        with pytest.raises(WebSocketDisconnect), client.websocket_connect("/live", subprotocols=wrong):
            raise AssertionError("opened")
        assert client.get("/").status_code == 200
        edition = "/static/v-0123456789abcdef"
        assert client.get(f"{edition}/js/main.js").status_code == 200
        for path in ("/tasks", f"{edition}/../../tasks", "/static/../tasks", "/static/splits", "/staticx"):
            assert client.get(path).status_code == 401


def test_a_full_house_of_pages_is_told_so(tmp_path: Path) -> None:
    with (
        TestClient(create_app(Settings(data=tmp_path, capacity=4))) as client,
        client.websocket_connect("/live") as socket,
        client.websocket_connect("/live"),
    ):
        page = Page(socket)
        (shown,) = page.start("greedy")
        page.send("step")
        page.until("frames")
        with client.websocket_connect("/live") as late, pytest.raises(WebSocketDisconnect) as closed:
            late.receive_text()
        assert (closed.value.code, closed.value.reason) == (1013, "too many pages are open")
        # The second of the two does not evict the first, which has no steps either.
        page.send("start", task="easy", pilots=["greedy", "random"], seed=7)
        assert page.until("error")["code"] == "no_room"
        # The place that the first of the two had is free again, and the flight before them is flown on.
        assert client.post("/reset").status_code == 200
        page.send("step")
        assert page.until("frames")["frames"][0]["frame"]["step"] == 2
        assert client.get("/state", headers={"X-Session-Id": shown["opening"]["session"]}).json()["step_count"] == 2
