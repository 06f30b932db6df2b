"""The WebSocket `/live`: commands of a page in, frames of its missions out.

The missions are HTTP sessions, so they outlive the connection and the process: a page that comes back attaches to them.
"""

import asyncio
import logging
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import anyio
from anyio.abc import TaskGroup
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from drone_env.core.tasks import get_task
from drone_env.errors import DroneEnvError, UnknownNameError
from drone_env.server.frames import Frame
from drone_env.server.live.commands import (
    Attach,
    End,
    Fly,
    Pause,
    Play,
    Start,
    Step,
    Subscribe,
    parse_command,
)
from drone_env.server.live.feeds import Feed
from drone_env.server.live.missions import LiveMission
from drone_env.server.live.values import ExactValues
from drone_env.server.map_choice import choose_map
from drone_env.server.pilots import PILOTS, agent_of
from drone_env.server.problems import FAILED, printable, status_of
from drone_env.server.schemas import EpisodeSummary, ResetOptions
from drone_env.server.state import Shared

log = logging.getLogger(__name__)

PROTOCOL = "drone-env"
"""The subprotocol that browsers offer beside `bearer.TOKEN`: they cannot send headers with a WebSocket."""
TOO_BIG, TRY_LATER = 1009, 1013
SPEED = 6.0
FEED_SECONDS = 0.25
Moved = list[tuple[int, list[Frame]]]


class LiveSocket:
    """The endpoint: an ASGI application.

    Args:
        shared: The parts of the server.
    """

    def __init__(self, shared: Shared) -> None:
        self.shared = shared
        self.values = ExactValues()
        self.cockpits: set[Cockpit] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one page until it goes."""
        socket = WebSocket(scope, receive, send)
        await socket.accept(PROTOCOL if PROTOCOL in scope.get("subprotocols", []) else None)
        # Where the other side has gone there is nobody left to tell.
        with suppress(WebSocketDisconnect, OSError):
            if len(self.cockpits) >= self.shared.settings.capacity:
                await socket.close(TRY_LATER, "too many pages are open: try again later")
                return
            cockpit = Cockpit(socket, self.shared, self.values)
            self.cockpits.add(cockpit)
            try:
                await cockpit.run()
            finally:
                self.cockpits.discard(cockpit)

    def keep_sessions(self) -> None:
        """Count the missions of all open pages as used: whoever looks at a flight may pause it for long.

        Raises:
            StoreError: if the store could not be written.
        """
        sessions = [mission.session for cockpit in list(self.cockpits) for mission in cockpit.missions]
        if sessions:
            self.shared.store.touch_sessions(sessions)

    def close(self) -> None:
        """Stop solving maps."""
        self.values.close()


class Cockpit:
    """One open page: its missions, and whether they are flying."""

    def __init__(self, socket: WebSocket, shared: Shared, values: ExactValues) -> None:
        self.missions: list[LiveMission] = []
        self.playing = False
        self.speed = SPEED
        self._socket = socket
        self._shared = shared
        self._values = values
        self._told_end: set[str] = set()
        self._flying = asyncio.Lock()
        self._changed = asyncio.Event()
        self._solving = anyio.CancelScope()
        self._feed: Feed | None = None
        self._tasks: TaskGroup

    async def run(self) -> None:
        """Serve the page until it goes."""
        async with anyio.create_task_group() as tasks:
            self._tasks = tasks
            tasks.start_soon(self._play)
            tasks.start_soon(self._tell_news)
            await self._listen()
            tasks.cancel_scope.cancel()

    async def _listen(self) -> None:
        while True:
            message = await self._socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            text = message.get("text") or ""
            if len(text.encode("utf-8", "surrogatepass")) > self._shared.settings.max_bytes:
                await self._socket.close(TOO_BIG, f"a frame may have {self._shared.settings.max_bytes} bytes")
                return
            await self._answering(self._obey, text)
            # Where more has come already, nothing above needs to wait: others get their turn.
            await asyncio.sleep(0)

    async def _answering(self, act: Callable[..., Any], *arguments: Any, told: bool = False) -> bool:
        """Do something; what goes wrong is told to the page, unless that has been told. Whether it went well."""
        try:
            await act(*arguments)
        except Exception as error:
            if not told:
                await self._send({"type": "error", **_problem(error)})
            return False
        return True

    async def _obey(self, text: str) -> None:
        match parse_command(text):
            case Subscribe(topics=topics):
                self._feed = Feed(self._shared, topics)
            case Pause():
                await self._set_playing(False)
            case Play(speed=speed):
                self.speed = speed or self.speed
                await self._set_playing(any(mission.automatic for mission in self.missions))
            case command:
                async with self._flying:
                    await self._fly(command)

    async def _fly(self, command: Start | Attach | End | Step | Fly) -> None:
        match command:
            case Start() | Attach():
                await self._replace_missions(await run_in_threadpool(self._opened, command), command.number)
            case End():
                await self._replace_missions([], None)
            case Step():
                await self._tell(await run_in_threadpool(self._step_all))
            case Fly(mission=number, direction=direction):
                if number >= len(self.missions):
                    raise UnknownNameError("mission", str(number), [str(i) for i in range(len(self.missions))])
                await self._tell([(number, await run_in_threadpool(self.missions[number].fly, direction))])

    async def _replace_missions(self, opened: list[LiveMission], number: int | None) -> None:
        kept = {mission.session for mission in opened}
        left = [mission for mission in self.missions if mission.session not in kept]
        self.missions = opened
        await self._set_playing(False)
        await run_in_threadpool(_end_all, left)
        await self._tell_missions(number)

    def _opened(self, command: Start | Attach) -> list[LiveMission]:
        if isinstance(command, Attach):
            return [self._mission(session) for session in dict.fromkeys(command.sessions)]
        task = get_task(command.task)
        for pilot in command.pilots:
            if pilot not in PILOTS:
                raise UnknownNameError("pilot", pilot, PILOTS)
            agent_of(pilot, task, self._shared.networks)  # says why it cannot fly before anything is opened
        last = self.missions[0].episode if self.missions and self.missions[0].episode.task == task else None
        options = ResetOptions(task_name=task.id, seed=command.seed, reward_profile=command.reward_profile)
        seed = choose_map(options, None if last is None else last.seed).seed
        opened: list[LiveMission] = []
        try:
            for pilot in command.pilots:
                named = options.model_copy(update={"seed": seed, "agent": pilot})
                opened.append(self._mission(self._shared.sessions.reset(None, named)[0]))
        except BaseException:
            _end_all(opened)
            raise
        return opened

    def _mission(self, session: str) -> LiveMission:
        return LiveMission(session, self._shared.sessions, self._shared.networks, self._values)

    def _step_all(self) -> Moved:
        return [(i, mission.step()) for i, mission in enumerate(self.missions) if mission.automatic]

    async def _tell_missions(self, asked: int | None) -> None:
        missions = list(self.missions)
        shown = await run_in_threadpool(
            lambda: [
                {"mission": m.opening.model_dump(), "frames": [f.model_dump() for f in m.frames()]} for m in missions
            ]
        )
        told = {"missions": shown, "number": asked, "playing": self.playing, "speed": self.speed}
        await self._send({"type": "missions", **told})
        self._told_end = {mission.session for mission in missions if mission.episode.ended}
        for number, mission in enumerate(missions):
            if mission.episode.ended:
                await self._tell_end(number, mission)
        if missions:
            self._tasks.start_soon(self._answering, self._tell_values, missions)

    async def _tell(self, moved: Moved) -> None:
        frames = [{"mission": i, "frame": frame.model_dump()} for i, new in moved for frame in new]
        if frames:
            await self._send({"type": "frames", "frames": frames})
        for number, mission in enumerate(self.missions):
            if mission.episode.ended and mission.session not in self._told_end:
                self._told_end.add(mission.session)
                await self._tell_end(number, mission)
                await self._send_values(number, mission)

    async def _tell_end(self, number: int, mission: LiveMission) -> None:
        found = await run_in_threadpool(lambda: self._shared.store.listed(1, episode_id=mission.episode_id))
        for listed in found:
            summary = EpisodeSummary.of(listed).model_dump()
            await self._send({"type": "ended", "mission": number, "episode": summary})

    async def _tell_values(self, missions: Sequence[LiveMission]) -> None:
        """Once the map is solved: what could be reached at the frames that were sent without it."""
        # Nobody looks at the missions before these any more.
        self._solving.cancel()
        episode = missions[0].episode
        with anyio.CancelScope() as self._solving:
            for task, seed in {(mission.episode.task, mission.episode.seed) for mission in missions}:
                await self._values.solved(task, seed)
            async with self._flying:
                if self.missions and self.missions[0].episode is episode:
                    for number, mission in enumerate(self.missions):
                        await self._send_values(number, mission)

    async def _send_values(self, number: int, mission: LiveMission) -> None:
        values = await run_in_threadpool(mission.reachable)
        if values is not None:
            regrets = [values[0] - value for value in values]
            await self._send({"type": "values", "mission": number, "values": values, "regrets": regrets})

    async def _set_playing(self, playing: bool) -> None:
        self.playing = playing
        self._changed.set()
        await self._send({"type": "playing", "playing": playing, "speed": self.speed})

    async def _play(self) -> None:
        """Let the missions fly while they are to, for ever."""
        clock = asyncio.get_running_loop().time
        ticked = 0.0
        while True:
            pause = ticked + 1 / self.speed - clock() if self.playing else None
            if pause is None or pause > 0:
                # Woken by a pause or another speed, it looks again.
                self._changed.clear()
                with suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._changed.wait(), pause)
                continue
            ticked = clock()
            if not await self._answering(self._tick):
                await self._set_playing(False)

    async def _tick(self) -> None:
        async with self._flying:
            if not self.playing:
                return
            await self._tell(await run_in_threadpool(self._step_all))
            if not any(mission.automatic for mission in self.missions):
                await self._set_playing(False)

    async def _tell_news(self) -> None:
        failing = False
        while True:
            feed = self._feed
            if feed is not None and feed.topics:
                failing = not await self._answering(self._send_news, feed, told=failing)
            await asyncio.sleep(FEED_SECONDS)

    async def _send_news(self, feed: Feed) -> None:
        for message in await run_in_threadpool(lambda: list(feed.news())):
            await self._send(message)

    async def _send(self, message: dict[str, Any]) -> None:
        if self._socket.application_state is not WebSocketState.CONNECTED:
            return  # the page has gone
        # Where it goes just now, `_listen` hears of that, after the last that the page has said.
        with suppress(WebSocketDisconnect, OSError):
            await self._socket.send_text(to_json(message).decode())


def _problem(error: Exception) -> dict[str, str]:
    """What a page is told of an error."""
    status, code = 500, "internal"
    if isinstance(error, DroneEnvError):
        status, code = status_of(error, "")
    elif isinstance(error, OSError):
        status, code = 503, "unavailable"
    if status == 500:
        # Unforeseen: a page that lost its connection for it would come back, and meet it again, for ever.
        log.error("/live failed", exc_info=error)
    return {"code": code, "detail": FAILED if status == 500 else printable(str(error))}


def _end_all(missions: Sequence[LiveMission]) -> None:
    for mission in missions:
        mission.end()
