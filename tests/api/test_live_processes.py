"""The WebSocket of the page on servers of their own: killed ones, and callers that do anything at any time."""

import json
import os
import random
from collections.abc import Generator
from pathlib import Path
from typing import Any

import httpx
import pytest
import websockets.sync.client as websockets_client

from drone_env.core.tasks import TASKS
from tests.api.serving import Server, serving
from tests.tools import reserved_port

COMMANDS = int(os.environ.get("DRONE_ENV_FRAMES", "2000")) // 4
Message = dict[str, Any]


@pytest.fixture
def server(tmp_path: Path) -> Generator[Server, None, None]:
    with serving(tmp_path / "data", CAPACITY="2000") as running:
        yield running


def test_a_killed_server_gives_the_mission_back(tmp_path: Path) -> None:
    port = reserved_port()
    url = f"ws://127.0.0.1:{port}/live"

    def ask(socket: Any, kind: str, answer: str, **fields: Any) -> Message:
        socket.send(json.dumps({"type": kind, **fields}))
        while True:
            message = json.loads(socket.recv(timeout=30))
            if message["type"] == answer:
                return message

    with serving(tmp_path / "data", port=port) as server, websockets_client.connect(url) as socket:
        shown = ask(socket, "start", "missions", task="hard", seed=7, pilots=["greedy"])
        for _ in range(5):
            ask(socket, "step", "frames")
        server.kill()
    with serving(tmp_path / "data", port=port) as server, websockets_client.connect(url) as socket:
        session = shown["missions"][0]["mission"]["session"]
        back = ask(socket, "attach", "missions", sessions=[session])
        assert len(back["missions"][0]["frames"]) == 6
        state = httpx.get(f"{server.url}/state", headers={"X-Session-Id": session}).json()
        assert state["step_count"] == 5


def commands(source: random.Random, sessions: list[str]) -> Any:
    """A command that is right, or nearly so."""
    flown = {"direction": source.choice(["UP", "WAIT", "up"]), "mission": source.randrange(-1, 5)}
    pilots = ["pathqnet", "greedy", "optimal", "random", "human", "ghost"]
    return source.choice(
        [
            {
                "type": "start",
                "task": source.choice([*list(TASKS)[:4], "nowhere"]),
                "seed": source.choice([None, 7, 2**53 - 1, -1]),
                "pilots": source.choices(pilots, k=source.randrange(6)),
            },
            {"type": "attach", "sessions": source.choices([*sessions, "nobody"], k=source.randrange(6))},
            {"type": "play", "speed": source.choice([0.5, 6, 60, 61, None, "fast"])},
            {"type": "pause"},
            {"type": "subscribe", "topics": source.choices(["requests", "training", "episodes", "x"], k=2)},
            {"type": "end"},
            source.choice([[], None, 5, "step", {"type": None}, {"type": "step", "more": 1}]),
            *[{"type": "fly", **flown}] * 2,
            *[{"type": "step"}] * 3,
        ]
    )


def test_anything_at_any_time_leaves_the_server_well(server: Server) -> None:
    source = random.Random(7)
    sessions: list[str] = []
    left = COMMANDS
    while left > 0:
        with websockets_client.connect(server.url.replace("http", "ws") + "/live", compression=None) as socket:
            for _ in range(source.randrange(1, 80)):
                left -= 1
                socket.send(json.dumps(commands(source, sessions)))
                try:
                    while True:
                        message = json.loads(socket.recv(timeout=0.002))
                        for shown in message["missions"] if message["type"] == "missions" else ():
                            sessions = [*sessions, shown["mission"]["session"]][-20:]
                except TimeoutError:
                    continue
            if source.random() < 0.5:
                socket.socket.close()  # without a goodbye
    with websockets_client.connect(server.url.replace("http", "ws") + "/live") as socket:
        socket.send(json.dumps({"type": "start", "task": "easy", "seed": 7, "pilots": ["greedy"]}))
        while json.loads(socket.recv(timeout=30))["type"] != "missions":
            pass
    assert httpx.get(f"{server.url}/health").status_code == 200
    assert "Traceback" not in server.log.read_text()
