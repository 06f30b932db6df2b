"""OpenEnv's WebSocket: one session per connection, speaking the protocol of OpenEnv's own server.

That server would do, except for what it does with frames that nobody planned for (a list ends the session, 16 MiB are
read, unknown options are dropped without a word), with idle sessions (the slot is freed, the socket is not), and with
time: it validates every observation twice, in a thread of its own. The frames are the same, and the tests hold both
servers side by side.
"""

import asyncio
import logging
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from typing import Any, cast

from pydantic import ValidationError
from pydantic_core import to_json
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from drone_env.core.episode import NOT_STARTED, Episode
from drone_env.errors import DroneEnvError, EpisodeError, InvalidValueError, text_of, wrong_parts
from drone_env.models import DroneState
from drone_env.results.sessions import Session, advance, flight_of
from drone_env.server.incoming import SMALL, TRY_LATER, parse_json, received
from drone_env.server.map_choice import start_episode
from drone_env.server.observation_json import openenv_json
from drone_env.server.schemas import ResetOptions, WireAction
from drone_env.server.sessions import ANONYMOUS
from drone_env.server.state import Shared

log = logging.getLogger(__name__)

NORMAL, GOING_AWAY = 1000, 1001
ALLOWED_TYPES = "reset, step, state, close, mcp"


class RefusedError(Exception):
    """A frame that is answered with an error; the session goes on.

    Args:
        code: OpenEnv's code.
        message: What is wrong, for people.
        more: What else the error says: `errors`, the parts that are wrong.
    """

    def __init__(self, code: str, message: str, **more: object) -> None:
        super().__init__(message)
        data = {"message": message, "code": code, **more}
        self.frame = _frame("error", to_json(data).decode())


class Connection:
    """The session of a connection, and the name that its client gave the episode."""

    def __init__(self) -> None:
        self._session: Session | None = None
        self._episode_id = ""

    def reset(self, options: ResetOptions) -> Episode:
        """Start an episode. On an error the running one is left as it was.

        Raises:
            UnknownNameError: if there is no such task, profile or split.
            InvalidValueError: if the split has no such map.
        """
        episode = start_episode(options, None if self._session is None else self._session.seed)
        self._session = Session("", *flight_of(episode), options.agent or ANONYMOUS, episode=episode)
        self._episode_id = options.episode_id if options.episode_id is not None else str(uuid.uuid4())
        return episode

    def started(self) -> Session:
        """The session.

        Raises:
            EpisodeError: before the first reset.
        """
        if self._session is None:
            raise EpisodeError(NOT_STARTED)
        return self._session

    def state(self) -> DroneState:
        """The full state. Raises as `started`."""
        return DroneState.of(self.started().fly()).model_copy(update={"episode_id": self._episode_id})


class OpenEnvSocket:
    """The WebSocket endpoint: an ASGI application. A socket on which nothing arrives for too long is closed.

    Args:
        shared: The parts of the server.
        clock: Gives the time in seconds since any start.
    """

    def __init__(self, shared: Shared, clock: Callable[[], float] = time.monotonic) -> None:
        self.shared = shared
        self._clock = clock
        self.touched: dict[WebSocket, float] = {}
        """When each open socket was last used."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection to its end."""
        socket = WebSocket(scope, receive, send)
        # Clients may go at any time, even before the server accepts them.
        with suppress(WebSocketDisconnect, OSError):
            await socket.accept()
            capacity = self.shared.settings.capacity
            try:
                if "session_id" in socket.query_params:
                    message = "every connection has a session of its own: leave out session_id"
                    raise RefusedError("SESSION_ERROR", message)
                if len(self.touched) >= capacity:
                    message = f"{capacity} sessions are open, and no more are allowed: try again later"
                    raise RefusedError("CAPACITY_REACHED", message)
                self.touched[socket] = self._clock()
                await self._serve(socket)
            except RefusedError as refusal:
                await socket.send_text(refusal.frame)
                await socket.close(TRY_LATER, str(refusal)[:120])
            finally:
                self.touched.pop(socket, None)

    async def _serve(self, socket: WebSocket) -> None:
        connection = Connection()
        async for data in received(socket, SMALL):
            if socket not in self.touched:
                return  # closed as idle
            self.touched[socket] = self._clock()
            try:
                if data is None:
                    raise RefusedError("INVALID_JSON", "send text frames with JSON")
                answer = await self._answer(connection, data)
            except RefusedError as refusal:
                answer = refusal.frame
            if answer is None:
                await socket.close(NORMAL)
                return
            if socket not in self.touched:
                return
            await socket.send_text(answer)
            self.touched[socket] = self._clock()

    async def _answer(self, connection: Connection, received: bytes) -> str | None:
        """The answer to a frame, None where it asks to close.

        Raises:
            RefusedError: if the frame cannot be answered.
        """
        try:
            frame = parse_json(received)
        except InvalidValueError as error:
            raise RefusedError("INVALID_JSON", str(error)) from None
        if not isinstance(frame, dict):
            raise RefusedError("VALIDATION_ERROR", 'a frame is an object, such as {"type": "reset", "data": {}}')
        frame = cast(dict[str, Any], frame)
        kind, data = frame.get("type"), frame.get("data", {})
        if frame.keys() - {"type", "data"} or not isinstance(data, dict):
            raise RefusedError("VALIDATION_ERROR", "a frame has `type` and `data`, an object, and nothing else")
        data = cast(dict[str, Any], data)
        try:
            if kind == "step":
                return await self._step(connection, data)
            if kind == "reset":
                episode = connection.reset(ResetOptions.model_validate(data))
                return _frame("observation", openenv_json(episode, None))
            if kind == "state":
                return _frame("state", connection.state().model_dump_json())
        except ValidationError as error:
            errors = [{"loc": [where], "msg": why, "type": kind} for where, why, kind in wrong_parts(error)]
            raise RefusedError("VALIDATION_ERROR", f"Invalid message: {text_of(error)}", errors=errors) from None
        except LookupError as error:
            raise RefusedError("VALIDATION_ERROR", str(error)) from None
        except DroneEnvError as error:
            raise RefusedError("EXECUTION_ERROR", str(error)) from None
        if kind == "close":
            return None
        if kind == "mcp":
            return _frame("mcp", to_json(mcp_answer(data)).decode())
        raise RefusedError("UNKNOWN_TYPE", f"Unknown message type: {kind!r}; allowed: {ALLOWED_TYPES}")

    async def _step(self, connection: Connection, data: dict[str, Any]) -> str:
        action = WireAction.model_validate(data).action
        session = connection.started()
        episode = session.fly()
        # Ended and not kept, it has answered an error: the same step again is answered as it would have been.
        reward = episode.reward_last if session.finished else advance(session, action)
        if session.finished:
            await asyncio.get_running_loop().run_in_executor(self.shared.steps, self.shared.store.keep, session)
        return _frame("observation", openenv_json(episode, reward))

    async def close_idle(self) -> None:
        """Close the sockets that were idle for too long."""
        limit = self._clock() - self.shared.settings.idle_seconds
        idle = [socket for socket, touched in self.touched.items() if touched < limit]
        for socket in idle:
            del self.touched[socket]
        # All at once: each waits for its client to say goodbye, which may take seconds.
        await asyncio.gather(*map(self._close_idle, idle))

    async def _close_idle(self, socket: WebSocket) -> None:
        try:
            await socket.close(GOING_AWAY, f"idle for {self.shared.settings.idle_seconds:g} s: connect again")
        except (RuntimeError, WebSocketDisconnect, OSError):
            log.debug("an idle socket had been closed already")


def mcp_answer(request: Any) -> dict[str, Any]:
    """The JSON-RPC answer to any MCP request: this environment has no tools."""
    asked = cast(dict[str, Any], request) if isinstance(request, dict) else {}
    valid = asked.get("jsonrpc") == "2.0" and isinstance(asked.get("method"), str)
    number = asked.get("id")
    answer: dict[str, Any] = {"jsonrpc": "2.0", "id": number if isinstance(number, str | int) else None}
    if not valid:
        message = 'a request has "jsonrpc": "2.0" and a method'
        return answer | {"error": {"code": -32600, "message": f"Invalid Request: {message}"}}
    if asked["method"] == "tools/list":
        return answer | {"result": {"tools": []}}
    return answer | {"error": {"code": -32601, "message": "Method not found: this environment has no MCP tools"}}


def _frame(kind: str, data: str) -> str:
    """A frame around the JSON of its data."""
    return f'{{"type":"{kind}","data":{data}}}'
