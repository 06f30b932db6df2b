"""Sessions that know what their server has to answer: each flies an episode of its own beside it."""

import asyncio
import json
import random
from collections.abc import Callable, Sequence
from typing import Any

import httpx
import websockets
import websockets.exceptions
from pydantic_core import from_json, to_json

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE
from drone_env.models import DroneState, observation_fields
from tests.tools import PATIENCE

TASK = "hard"
Progress = Callable[[], None]


class Client(httpx.AsyncClient):
    """Sends so many requests at a time: the time that httpx takes grows with the square of those that wait."""

    def __init__(self, url: str, at_once: int = 32) -> None:
        super().__init__(base_url=url, timeout=PATIENCE)
        self._gate = asyncio.Semaphore(at_once)

    async def send(self, *request: Any, **options: Any) -> httpx.Response:
        async with self._gate:
            return await super().send(*request, **options)


class Reference:
    """The episode that a session flies, here."""

    def __init__(self, seed: int) -> None:
        self.episode = Episode(TASK, ORIGINAL_PROFILE, seed)
        self.moves = random.Random(seed)

    def action(self) -> Action:
        return Action(self.moves.randrange(5))

    def fields(self) -> dict[str, Any]:
        return from_json(to_json(observation_fields(self.episode)))


def socket_result(fields: dict[str, Any], reward: float | None, flown: int, profile: str) -> dict[str, Any]:
    """The answer to a step over OpenEnv's socket: reward and done beside the rest. Takes the fields for its own."""
    done, metadata = fields.pop("done"), {"reward_profile": profile, "flown": flown}
    observation = {**fields, "metadata": metadata, "prompt": ""}
    return {"observation": observation, "reward": reward, "done": done, "metadata": metadata}


class HttpSession:
    """A session over HTTP.

    Args:
        client: To send with.
        seed: Its map.
        counts: Whether its steps say which one they follow.
    """

    def __init__(self, client: Client, seed: int, counts: bool) -> None:
        self.client = client
        self.steps = client
        self.seed = seed
        self.counts = counts
        self.unanswered = self.broken = 0
        self.reference = Reference(seed)
        self.headers: dict[str, str] = {}

    async def open(self) -> None:
        answer = await self.client.post("/reset", json={"task_name": TASK, "seed": self.seed})
        assert answer.status_code == 200, answer.text
        self.headers = {"X-Session-Id": answer.json()["session_id"]}

    async def fly(self, steps: int, progress: Progress) -> None:
        for _ in range(steps):
            await self.step()
            progress()

    async def step(self) -> None:
        action, episode = self.reference.action(), self.reference.episode
        count = {"X-Step-Count": str(episode.steps)} if self.counts else {}
        headers = {**self.headers, **count}
        try:
            answer = await self.steps.post("/step", json={"direction": action.name}, headers=headers)
        except (httpx.ReadError, httpx.RemoteProtocolError, httpx.WriteError):
            # nginx reloaded while the connection was idle, or the server was killed while it sent the response.
            self.broken += 1
            answer = None
            if self.counts:
                answer = await self.steps.post("/step", json={"direction": action.name}, headers=headers)
        if not self.counts and (answer is None or answer.status_code == 502):
            # Nobody knows whether it was flown, and nobody has flown it twice.
            assert answer is None or answer.json()["code"] == "no_server"
            self.unanswered += 1
            flown = (await self.state())["step_count"] - episode.steps
            assert flown in (0, 1)
            if flown:
                episode.step(action)
            return
        assert answer is not None
        assert answer.status_code == 200, answer.text
        episode.step(action)
        assert answer.json() == self.reference.fields()

    async def state(self) -> dict[str, Any]:
        answer = await self.client.get("/state", headers=self.headers)
        assert answer.status_code == 200, answer.text
        return answer.json()

    async def check(self) -> None:
        assert await self.state() == DroneState.of(self.reference.episode).model_dump(mode="json")


class SocketSession:
    """A session over OpenEnv's WebSocket."""

    def __init__(self, url: str, seed: int) -> None:
        self.url = url.replace("http", "ws") + "/ws"
        self.seed = seed
        self.lost = False
        self.reference = Reference(seed)
        self.socket: Any = None

    async def open(self) -> None:
        self.socket = await websockets.connect(self.url, compression=None, open_timeout=PATIENCE, ping_interval=None)
        options = {"task_name": TASK, "seed": self.seed, "reward_profile": ORIGINAL_PROFILE}
        assert await self.ask("reset", options)

    async def ask(self, kind: str, data: dict[str, Any]) -> Any:
        await self.socket.send(json.dumps({"type": kind, "data": data}))
        answer = json.loads(await self.socket.recv())
        assert answer["type"] == "observation", answer
        return answer["data"]

    async def fly(self, steps: int, progress: Progress) -> None:
        for _ in range(0 if self.lost else steps):
            action = self.reference.action()
            try:
                answer = await self.ask("step", {"direction": action.name})
            except websockets.exceptions.ConnectionClosed:
                self.lost = True
                return
            reward = self.reference.episode.step(action)
            assert answer == socket_result(self.reference.fields(), reward, 1, ORIGINAL_PROFILE)
            progress()

    async def close(self) -> None:
        await self.socket.close()


async def fly_all(
    sessions: Sequence[HttpSession | SocketSession], steps: int, progress: Progress = lambda: None
) -> None:
    """Fly so many steps in each session, all at once."""
    await asyncio.gather(*[session.fly(steps, progress) for session in sessions])
