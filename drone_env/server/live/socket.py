"""The WebSocket `/live`: commands of a page in, frames of its episodes out.

The episodes are flown in HTTP sessions, so they outlive the connection and the process: a page that comes back attaches
to them. On the wire they are flights, by their number among those of the page.
"""

import asyncio
import logging
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

import anyio
from anyio.abc import TaskGroup
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from drone_env.errors import TooLargeError, UnknownNameError
from drone_env.server.frames import Frame
from drone_env.server.incoming import LARGE, TRY_LATER, received
from drone_env.server.live.commands import Attach, ByHand, Fly, Plain, Play, Start, Subscribe, Topic, parse_command
from drone_env.server.live.episodes import LeftError, LiveEpisode, Opened, attach, end_all, open_flights
from drone_env.server.logs import TrainLog
from drone_env.server.problems import FAILED, status_of
from drone_env.server.state import Shared, caller_address

log = logging.getLogger(__name__)

PROTOCOL = "drone-env"
"""The subprotocol that browsers offer beside `bearer.TOKEN`: they cannot send headers with a WebSocket."""
TOO_MANY_PAGES = "too many pages are open"
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
        self.pages: set[Page] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one page until it goes."""
        socket = WebSocket(scope, receive, send)
        # Clients may go at any time, even before the server accepts them.
        with suppress(WebSocketDisconnect, OSError):
            await socket.accept(PROTOCOL if PROTOCOL in scope.get("subprotocols", []) else None)
            if len(self.pages) >= self.shared.settings.capacity:
                await socket.close(TRY_LATER, TOO_MANY_PAGES)
                return
            page = Page(socket, self.shared)
            self.pages.add(page)
            try:
                await page.run()
            finally:
                self.pages.discard(page)

    def keep_sessions(self) -> None:
        """Count the sessions of all open pages as used: a flight that is looked at may be paused for long.

        Raises:
            StoreError: if the store could not be written.
        """
        sessions = [live.row.id for page in list(self.pages) for live in page.episodes]
        if sessions:
            self.shared.store.touch_sessions(sessions)


class Page:
    """One open page: its episodes, and whether they are flying."""

    def __init__(self, socket: WebSocket, shared: Shared) -> None:
        self.episodes: list[LiveEpisode] = []
        self.playing = False
        self.speed = SPEED
        self._socket = socket
        self._shared = shared
        self._caller = caller_address(socket)
        self._end_sent: set[LiveEpisode] = set()
        self._flying = asyncio.Lock()
        self._changed = asyncio.Event()
        self._lacking = asyncio.Event()
        self._feed: Feed | None = None
        self._subscribed = asyncio.Event()
        self._tasks: TaskGroup

    async def run(self) -> None:
        """Serve the page until it goes."""
        try:
            async with anyio.create_task_group() as tasks:
                self._tasks = tasks
                for work in (self._listen, self._play, self._watch_values, self._tell_news):
                    tasks.start_soon(work)
        finally:
            for live in self.episodes:
                live.leave()

    async def _listen(self) -> None:
        async for data in received(self._socket, LARGE):
            await self._answering(self._obey, data or b"")
        self._tasks.cancel_scope.cancel()

    async def _answering(self, act: Callable[..., Any], *arguments: Any, silent: bool = False) -> bool:
        """Do something, and send the page what goes wrong, unless `silent`. Whether it went well."""
        try:
            await act(*arguments)
        except Exception as error:
            if not silent:
                await self._send({"type": "error", **_problem(error)})
            return False
        return True

    async def _obey(self, data: bytes) -> None:
        command = parse_command(data)
        async with self._flying:
            match command:
                case Subscribe(topics=topics):
                    self._feed = Feed(self._shared, topics) if topics else None
                    self._subscribed.set() if topics else self._subscribed.clear()
                case Plain(type="pause"):
                    await self._set_playing(False)
                case Play(speed=speed):
                    self.speed = speed or self.speed
                    await self._set_playing(any(live.automatic for live in self.episodes))
                case Plain(type="step"):
                    await self._step_all()
                case Fly(flight=number, direction=direction):
                    await self._tell([(number, await run_in_threadpool(self._at(number).fly, direction))])
                case ByHand(type="undo", flight=number):
                    await self._undo(number)
                case ByHand(flight=number):  # "help"
                    live = self._at(number)
                    frame = await run_in_threadpool(live.help)
                    await self._send({"type": "helped", "flight": number, "by": live.row.agent, "frame": frame})
                    await self._send_values(number, live)
                    self._lacking.set()
                case Start():
                    last = self.episodes[0].episode if self.episodes else None
                    opened = await open_flights(command, self._shared, self._caller, last)
                    await self._replace(opened, command.number)
                case Attach():
                    sessions = dict.fromkeys(command.sessions)
                    opened = [await attach(session, self._shared, self._caller) for session in sessions]
                    await self._replace(opened, command.number)
                case Plain():  # "end"
                    await self._replace([], None)

    def _at(self, number: int) -> LiveEpisode:
        if number >= len(self.episodes):
            raise UnknownNameError("flight", str(number), [str(i) for i in range(len(self.episodes))])
        return self.episodes[number]

    async def _undo(self, number: int) -> None:
        live = self._at(number)
        missed = await run_in_threadpool(live.undo)
        if missed:
            await self._tell([(number, missed)])
        else:
            await self._send({"type": "undone", "flight": number, "step": live.episode.steps, "by": live.row.agent})

    async def _step_all(self) -> None:
        automatic = [(number, live) for number, live in enumerate(self.episodes) if live.automatic]
        for _, live in automatic:
            await live.planned()

        def step_all() -> Moved:
            return [(number, live.step()) for number, live in automatic]

        await self._tell(await run_in_threadpool(step_all))

    async def _replace(self, opened: Opened, asked: int | None) -> None:
        """Show these episodes, and give up those before them that are not among them."""
        kept = {live.row.id for live, _ in opened}
        left = [live for live in self.episodes if live.row.id not in kept]
        for live in self.episodes:
            live.leave()
        self.episodes = [live for live, _ in opened]
        self._end_sent.clear()
        await self._set_playing(False)
        await run_in_threadpool(end_all, left)
        rest = to_json({"number": asked, "playing": self.playing, "speed": self.speed}).decode()[1:]
        await self._send_text(f'{{"type":"flights","flights":[{",".join(shown for _, shown in opened)}],{rest}')
        await self._tell([])

    async def _tell(self, moved: Moved) -> None:
        """Tell of new frames, and of episodes that have ended."""
        frames = [{"flight": number, "frame": frame} for number, new in moved for frame in new]
        if frames:
            await self._send({"type": "frames", "frames": frames})
        for number, live in enumerate(self.episodes):
            if live.episode.ended and live not in self._end_sent:
                self._end_sent.add(live)
                for row in await run_in_threadpool(self._shared.store.listed, 1, episode_id=live.row.episode_id):
                    await self._send({"type": "ended", "flight": number, "episode": row})
                await self._send_values(number, live)
        if any(live.lacks_values for live in self.episodes):
            self._lacking.set()

    async def _watch_values(self) -> None:
        """Find out what could be reached at the frames that were sent without it, and send that, forever."""
        while True:
            await self._lacking.wait()
            self._lacking.clear()
            for number, live in enumerate(self.episodes):
                if live.lacks_values:
                    await self._answering(self._find_values, number, live)

    async def _find_values(self, number: int, live: LiveEpisode) -> None:
        with suppress(TooLargeError, LeftError):
            await live.solve()
        async with self._flying:
            if live in self.episodes:
                await self._send_values(number, live)

    async def _send_values(self, number: int, live: LiveEpisode) -> None:
        values = live.reachable()
        if values is not None:
            regrets = [values[0] - value for value in values]
            await self._send({"type": "values", "flight": number, "values": values, "regrets": regrets})

    async def _set_playing(self, playing: bool) -> None:
        self.playing = playing
        self._changed.set()
        await self._send({"type": "playing", "playing": playing, "speed": self.speed})

    async def _play(self) -> None:
        """Let the episodes fly while they are to, forever."""
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
        # Without the lock, so that the page can pause or start another flight while a pilot plans.
        with suppress(LeftError):
            for live in self.episodes:
                if live.automatic:
                    await live.planned()
        async with self._flying:
            if not self.playing:
                return
            await self._step_all()
            if not any(live.automatic for live in self.episodes):
                await self._set_playing(False)

    async def _tell_news(self) -> None:
        """Look for news while the page wants any: other processes write the log and the store."""
        failing = False
        while True:
            await self._subscribed.wait()
            failing = not await self._answering(self._send_news, silent=failing)
            await asyncio.sleep(FEED_SECONDS)

    async def _send_news(self) -> None:
        if self._feed is not None:
            for message in await run_in_threadpool(list, self._feed.news()):
                await self._send(message)

    async def _send(self, message: dict[str, Any]) -> None:
        await self._send_text(to_json(message).decode())

    async def _send_text(self, text: str) -> None:
        if self._socket.application_state is not WebSocketState.CONNECTED:
            return  # the page has gone
        # Where it goes just now, `_listen` hears of that, after the last that the page has said.
        with suppress(WebSocketDisconnect, OSError):
            await self._socket.send_text(text)


def _problem(error: Exception) -> dict[str, str]:
    """What a page receives of an error."""
    status, code = (503, "unavailable") if isinstance(error, OSError) else status_of(error, "")
    if status == 500:
        # Unforeseen: a page that lost its connection for it would come back and meet it again, forever.
        log.error("/live failed", exc_info=error)
    return {"code": code, "detail": FAILED if status == 500 else str(error)}


EPISODES = 50
LINES = 200


class Feed:
    """The news of some topics, for one page.

    Args:
        shared: The parts of the server.
        topics: Which news the page wants.
    """

    def __init__(self, shared: Shared, topics: list[Topic]) -> None:
        self.topics = topics
        self._shared = shared
        self._request: int | None = None
        self._episode: int | None = None
        self._log = TrainLog(shared.settings.data)

    def news(self) -> Iterator[dict[str, Any]]:
        """The messages that are due; at first what there is, then what is new.

        Raises:
            StoreError: if the store cannot be read.
        """
        if "requests" in self.topics:
            entries = self._shared.requests.since(self._request or 0)
            if entries or self._request is None:
                self._request = entries[-1].number if entries else 0
                yield {"type": "requests", "requests": entries}
        if "training" in self.topics and self._log.has_changed():
            yield {"type": "training", "lines": self._log.tail(LINES), "curve": self._log.curve()}
        if "episodes" in self.topics:
            found = self._shared.store.listed(EPISODES, after=self._episode)
            if found or self._episode is None:
                self._episode = found[0].number if found else 0
                yield {"type": "episodes", "episodes": found}
