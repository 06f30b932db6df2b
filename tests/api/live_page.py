"""A page that has opened `/live`, for tests."""

import json
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from starlette.testclient import TestClient, WebSocketTestSession

from drone_env.agents import make_agent
from drone_env.core.episode import Episode, rollout
from drone_env.models import DIRECTIONS, Direction

Message = dict[str, Any]


class Page:
    """A page that has opened `/live`."""

    def __init__(self, socket: WebSocketTestSession) -> None:
        self.socket = socket
        self.ended: list[int] = []
        """The flights that were told to have ended, while they flew by themselves."""
        self.skipped: list[Message] = []
        """The messages that `until` read over."""

    def send(self, kind: str, **fields: Any) -> None:
        self.socket.send_text(json.dumps({"type": kind, **fields}))

    def until(self, kind: str) -> Message:
        """The next message of a kind. Others are read over, but for errors; before an error nothing may have moved."""
        while True:
            message = json.loads(self.socket.receive_text())
            if message["type"] == kind:
                return message
            assert message["type"] != "error", message
            self.skipped.append(message)
            assert kind != "error" or message["type"] in ("playing", "values"), message

    def start(self, *pilots: str, task: str = "easy", seed: int | None = 7, **fields: Any) -> list[Message]:
        self.send("start", task=task, seed=seed, pilots=pilots, **fields)
        return self.until("flights")["flights"]

    def flight(self) -> dict[int, list[Message]]:
        """The frames of each flight until all have ended."""
        frames: dict[int, list[Message]] = {}
        while True:
            message = json.loads(self.socket.receive_text())
            for moved in message["frames"] if message["type"] == "frames" else ():
                frames.setdefault(moved["flight"], []).append(moved["frame"])
            if message["type"] == "ended":
                self.ended.append(message["flight"])
            if message["type"] == "playing" and not message["playing"]:
                return frames


@contextmanager
def open_page(client: TestClient) -> Generator[Page, None, None]:
    with client.websocket_connect("/live") as socket:
        yield Page(socket)


def flown(
    task: str,
    agent: str,
    steps: int | None = None,
    seed: int = 7,
    profile: str = "tiered",
    start: Episode | None = None,
) -> Episode:
    """An agent's flight up to a step, from where `start` stands."""
    pilot, first = make_agent(agent, task), Episode(task, profile, seed)
    pilot.reset(seed)
    return first.copy().fly(rollout((start or first).copy(), pilot.act).actions[:steps])


def directions(episode: Episode) -> list[Direction]:
    return [DIRECTIONS[action] for action in episode.actions]
