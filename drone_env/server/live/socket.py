"""The WebSocket `/live`: receives the commands of a page, sends the frames of its episodes.

The episodes belong to HTTP sessions, so they outlive the connection and the process: a page that reconnects attaches to
them. Messages call them flights and number them per page.
"""

import asyncio
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

import anyio
from anyio.abc import TaskGroup
from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from drone_env.errors import TooLargeError, UnknownNameError
from drone_env.flights.sessions import in_share
from drone_env.server.exceptions import FAILED, status_of
from drone_env.server.frames import Frame
from drone_env.server.json_routes import LARGE, TRY_LATER, received
from drone_env.server.live.commands import Attach, ByHand, Fly, Plain, Play, Start, Subscribe, Topic, parse_command
from drone_env.server.live.episodes import LeftError, LiveEpisode, Opened, attach, end_all, open_flights
from drone_env.server.routes.history import listed
from drone_env.server.state import AppState, caller_address
from drone_env.server.train_log import TrainLog

log = logging.getLogger(__name__)

PROTOCOL = "drone-env"
"""The subprotocol that browsers offer beside `bearer.TOKEN`: they cannot send headers with a WebSocket."""
TOO_MANY_PAGES = "too many pages are open"
SPEED = 6.0
POLL_SECONDS = 0.25
Moved = Sequence[tuple[int, Frame]]
"""The new frame of each flight that moved, with the number of the flight."""


class LiveSocket:
    """The endpoint: an ASGI application.

    Args:
        app_state: The parts of the server.
    """

    def __init__(self, app_state: AppState) -> None:
        self.app_state = app_state
        self.pages: set[Page] = set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one page until it disconnects."""
        socket = WebSocket(scope, receive, send)
        # Clients may disconnect at any time, even before the server accepts them.
        with suppress(WebSocketDisconnect, OSError):
            await socket.accept(PROTOCOL if PROTOCOL in scope.get("subprotocols", []) else None)
            own = sum(page.caller == caller_address(socket) for page in self.pages)
            if not in_share(own, len(self.pages), self.app_state.settings.capacity):
                await socket.close(TRY_LATER, TOO_MANY_PAGES)
                return
            page = Page(socket, self.app_state)
            self.pages.add(page)
            try:
                await page.run()
            finally:
                self.pages.discard(page)

    def keep_sessions(self) -> None:
        """Mark the sessions of all open pages as used, because a page may pause a flight for long.

        Raises:
            StoreError: if the store could not be written.
        """
        sessions = [live.session.id for page in list(self.pages) for live in page.episodes]
        if sessions:
            self.app_state.sessions.touch(sessions)


class Page:
    """One open page and its episodes."""

    def __init__(self, socket: WebSocket, app_state: AppState) -> None:
        self.episodes: list[LiveEpisode] = []
        self.playing = False
        self.speed = SPEED
        self._socket = socket
        self._app_state = app_state
        self.caller = caller_address(socket)
        self._end_sent: set[LiveEpisode] = set()
        self._flying = asyncio.Lock()
        self._changed = asyncio.Event()
        self._values_due = asyncio.Event()
        self._subscription: Subscription | None = None
        self._subscribed = asyncio.Event()
        self._tasks: TaskGroup

    async def run(self) -> None:
        """Serve the page until it disconnects."""
        try:
            async with anyio.create_task_group() as tasks:
                self._tasks = tasks
                for work in (self._listen, self._play, self._watch_values, self._watch_topics):
                    tasks.start_soon(work)
        finally:
            for live in self.episodes:
                live.leave()

    async def _listen(self) -> None:
        async for data in received(self._socket, LARGE):
            await self._reporting(self._obey, data)
        self._tasks.cancel_scope.cancel()

    async def _reporting(self, act: Callable[..., Any], *arguments: Any, silent: bool = False) -> bool:
        """Call `act`, send its errors to the page unless `silent`, and return whether it succeeded."""
        try:
            await act(*arguments)
        except Exception as error:
            if not silent:
                await self._send({"type": "error", **_problem(error)})
            return False
        return True

    async def _obey(self, data: bytes | None) -> None:
        command = parse_command(data)
        async with self._flying:
            match command:
                case Subscribe(topics=topics):
                    self._subscription = Subscription(self._app_state, topics)
                    self._subscribed.set() if topics else self._subscribed.clear()
                case Plain(type="pause"):
                    await self._set_playing(False)
                case Play(speed=speed):
                    self.speed = speed or self.speed
                    await self._set_playing(any(live.automatic for live in self.episodes))
                case Plain(type="step"):
                    await self._step_all()
                case Fly(flight=number, direction=direction):
                    await self._send_frames([(number, await run_in_threadpool(self._at(number).fly, direction))])
                case ByHand(type="undo", flight=number):
                    live = self._at(number)
                    await run_in_threadpool(live.undo)
                    undone = {"type": "undone", "flight": number, "step": live.episode.steps}
                    await self._send({**undone, **live.flown_by})
                case ByHand(flight=number):  # "help"
                    live = self._at(number)
                    frame = await run_in_threadpool(live.help)
                    await self._send({"type": "helped", "flight": number, "frame": frame, **live.flown_by})
                    await self._send_values(number, live)
                    self._values_due.set()
                case Start():
                    last = self.episodes[0].episode if self.episodes else None
                    opened = await open_flights(command, self._app_state, self.caller, last)
                    await self._replace(opened, command.number)
                case Attach():
                    sessions = dict.fromkeys(command.sessions)
                    opened = [await attach(session, self._app_state, self.caller) for session in sessions]
                    await self._replace(opened, command.number)
                case Plain():  # "end"
                    await self._replace([], None)

    def _at(self, number: int) -> LiveEpisode:
        if number >= len(self.episodes):
            raise UnknownNameError("flight", str(number), [str(i) for i in range(len(self.episodes))])
        return self.episodes[number]

    async def _step_all(self) -> None:
        automatic = [(number, live) for number, live in enumerate(self.episodes) if live.automatic]
        for _, live in automatic:
            await live.planned()

        def step_all() -> Moved:
            return [(number, live.step()) for number, live in automatic]

        await self._send_frames(await run_in_threadpool(step_all))

    async def _replace(self, opened: Opened, request: int | None) -> None:
        """Show these episodes, and end the sessions of the others."""
        sessions = {live.session.id for live, _ in opened}
        left = [live for live in self.episodes if live.session.id not in sessions]
        for live in self.episodes:
            live.leave()
        self.episodes = [live for live, _ in opened]
        self._end_sent.clear()
        await self._set_playing(False)
        await run_in_threadpool(end_all, left, self._app_state)
        rest = to_json({"number": request, "playing": self.playing, "speed": self.speed}).decode()[1:]
        await self._send_text(f'{{"type":"flights","flights":[{",".join(view for _, view in opened)}],{rest}')
        await self._send_frames([])

    async def _send_frames(self, moved: Moved) -> None:
        """Send new frames, and the results of episodes that have ended."""
        if moved:
            frames = [{"flight": number, "frame": frame} for number, frame in moved]
            await self._send({"type": "frames", "frames": frames})
        for number, live in enumerate(self.episodes):
            if live.episode.ended and live not in self._end_sent:
                self._end_sent.add(live)
                for row in await run_in_threadpool(
                    listed, self._app_state.store, 1, episode_id=live.session.episode_id
                ):
                    await self._send({"type": "ended", "flight": number, "episode": row})
                await self._send_values(number, live)
        if any(live.lacks_values for live in self.episodes):
            self._values_due.set()

    async def _watch_values(self) -> None:
        """Compute and send the values of frames that were sent without them, forever."""
        while True:
            await self._values_due.wait()
            self._values_due.clear()
            for number, live in enumerate(self.episodes):
                if live.lacks_values:
                    await self._reporting(self._solve, number, live)

    async def _solve(self, number: int, live: LiveEpisode) -> None:
        with suppress(TooLargeError, LeftError):
            await live.solve()
        async with self._flying:
            if live in self.episodes:
                await self._send_values(number, live)

    async def _send_values(self, number: int, live: LiveEpisode) -> None:
        values = live.shown_values()
        if values is not None:
            regrets = [values[0] - value for value in values]
            await self._send({"type": "values", "flight": number, "values": values, "regrets": regrets})

    async def _set_playing(self, playing: bool) -> None:
        self.playing = playing
        self._changed.set()
        await self._send({"type": "playing", "playing": playing, "speed": self.speed})

    async def _play(self) -> None:
        """Fly the automatic episodes while `playing`, forever."""
        clock = asyncio.get_running_loop().time
        ticked = 0.0
        while True:
            pause = ticked + 1 / self.speed - clock() if self.playing else None
            if pause is None or pause > 0:
                # A pause or a new speed ends the wait.
                self._changed.clear()
                with suppress(asyncio.TimeoutError):
                    await asyncio.wait_for(self._changed.wait(), pause)
                continue
            ticked = clock()
            if not await self._reporting(self._tick):
                await self._set_playing(False)

    async def _tick(self) -> None:
        # Plans without the lock, so that the page can pause or start another flight meanwhile.
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

    async def _watch_topics(self) -> None:
        """Poll the topics that the page subscribed to: other processes write the log and the store."""
        failing = False
        while True:
            await self._subscribed.wait()
            failing = not await self._reporting(self._send_updates, silent=failing)
            await asyncio.sleep(POLL_SECONDS)

    async def _send_updates(self) -> None:
        if self._subscription is not None:
            for message in await run_in_threadpool(list, self._subscription.updates()):
                await self._send(message)

    async def _send(self, message: dict[str, Any]) -> None:
        await self._send_text(to_json(message).decode())

    async def _send_text(self, text: str) -> None:
        if self._socket.application_state is not WebSocketState.CONNECTED:
            return
        # `_listen` handles disconnects, after the last command of the page.
        with suppress(WebSocketDisconnect, OSError):
            await self._socket.send_text(text)


def _problem(error: Exception) -> dict[str, str]:
    """Code and detail of an error, for the page."""
    status, code = (503, "unavailable") if isinstance(error, OSError) else status_of(error, "")
    if status == 500:
        # The connection stays open: a page would reconnect and cause the same error again.
        log.error("/live failed", exc_info=error)
    return {"code": code, "detail": FAILED if status == 500 else str(error)}


EPISODES = 50
LINES = 200


class Subscription:
    """The messages of some topics, for one page.

    Args:
        app_state: The parts of the server.
        topics: The topics.
    """

    def __init__(self, app_state: AppState, topics: list[Topic]) -> None:
        self.topics = topics
        self._app_state = app_state
        self._request: int | None = None
        self._episode: int | None = None
        self._log = TrainLog(app_state.settings.data)

    def updates(self) -> Iterator[dict[str, Any]]:
        """The messages since the last call; the first call returns the current state.

        Raises:
            StoreError: if the store cannot be read.
        """
        if "requests" in self.topics:
            entries = self._app_state.requests.since(self._request or 0)
            if entries or self._request is None:
                self._request = entries[-1].number if entries else 0
                yield {"type": "requests", "requests": entries}
        if "training" in self.topics and self._log.has_changed():
            yield {"type": "training", "lines": self._log.tail(LINES), "curve": self._log.curve()}
        if "episodes" in self.topics:
            found = listed(self._app_state.store, EPISODES, after=self._episode)
            if found or self._episode is None:
                self._episode = found[0].number if found else 0
                yield {"type": "episodes", "episodes": found}
