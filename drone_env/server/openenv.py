"""OpenEnv's WebSocket protocol, `/ws`: one session per connection.

OpenEnv's own server is not used: a list as a frame ends its session, it reads 16 MiB, drops unknown options silently,
does not close idle sockets, and validates every observation twice in a thread. The frames are equal, and the tests
compare both servers.
"""

import asyncio
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, cast

from pydantic import ValidationError
from pydantic_core import to_json
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from drone_env.errors import DroneEnvError, InvalidValueError, UnknownNameError, text_of
from drone_env.flights.sessions import in_share
from drone_env.models import DroneState
from drone_env.server.json_bodies import TRY_LATER, parse_json, received
from drone_env.server.mcp import step_as_tool
from drone_env.server.openenv_session import OpenEnvSession
from drone_env.server.schemas import OpenEnvReset, RouteAction
from drone_env.server.state import AppState, caller_address

NORMAL, GOING_AWAY = 1000, 1001
LARGEST_FRAME = 16_384
"""Limit of a frame in bytes: enough for a list with the longest route."""
ALLOWED_TYPES = "reset, step, state, close"


class RefusedError(Exception):
    """A frame whose response is an error; the session continues.

    Args:
        code: OpenEnv's code.
        message: The message for people.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.frame = _frame("error", to_json({"message": message, "code": code}).decode())


class OpenEnvSocket:
    """The WebSocket endpoint, an ASGI application. It closes idle sockets.

    Args:
        app_state: The parts of the server.
        clock: Returns the time in seconds.
    """

    def __init__(self, app_state: AppState, clock: Callable[[], float] = time.monotonic) -> None:
        self.app_state = app_state
        self._clock = clock
        self.touched: dict[WebSocket, float] = {}
        """Time of the last use of each open socket."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        socket = WebSocket(scope, receive, send)
        # Clients may disconnect at any time, even before the server accepts them.
        with suppress(WebSocketDisconnect, OSError):
            await socket.accept()
            capacity = self.app_state.settings.capacity
            own = sum(caller_address(other) == caller_address(socket) for other in self.touched)
            try:
                if not in_share(own, len(self.touched), capacity):
                    taken = f"{len(self.touched)} of {capacity} sessions are open, {own} of this address"
                    raise RefusedError("CAPACITY_REACHED", f"{taken}, which is the limit: try again later")
                self.touched[socket] = self._clock()
                # OpenEnv's tool client names the session that it has opened over `/mcp`.
                session = OpenEnvSession(self.app_state, socket.query_params.get("session_id"))
                await self._serve(socket, session)
            except RefusedError as refusal:
                await socket.send_text(refusal.frame)
                await socket.close(TRY_LATER, str(refusal)[:120])
            finally:
                self.touched.pop(socket, None)

    async def _serve(self, socket: WebSocket, session: OpenEnvSession) -> None:
        async for data in received(socket, LARGEST_FRAME):
            if socket not in self.touched:
                return  # closed because it was idle
            self.touched[socket] = self._clock()
            try:
                answer = await self._answer(session, data)
            except RefusedError as refusal:
                answer = refusal.frame
            if answer is None:
                await socket.close(NORMAL)
                return
            if socket not in self.touched:
                return
            await socket.send_text(answer)
            self.touched[socket] = self._clock()

    async def _answer(self, session: OpenEnvSession, received: bytes | None) -> str | None:
        """Return the response to a frame; None if the client closes the session.

        Raises:
            RefusedError: if the frame is invalid or cannot be executed.
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
            if kind == "step" and data.get("type") in ("list_tools", "call_tool"):
                return _frame("observation", to_json(await step_as_tool(session, data)).decode())
            if kind == "step":
                episode, reward, flown = await session.fly(RouteAction.model_validate(data).direction)
                return _frame("observation", await session.observation(episode, reward, flown=flown))
            if kind == "reset":
                episode = await session.reset(OpenEnvReset.model_validate(data))
                return _frame("observation", await session.observation(episode, None))
            if kind == "state":
                state = DroneState.of(await session.look(), session.episode_id)
                return _frame("state", state.model_dump_json())
        except ValidationError as error:
            raise RefusedError("VALIDATION_ERROR", f"Invalid message: {text_of(error)}") from None
        except DroneEnvError as error:
            named = isinstance(error, UnknownNameError)
            raise RefusedError("VALIDATION_ERROR" if named else "EXECUTION_ERROR", str(error)) from None
        if kind == "close":
            return None
        raise RefusedError("UNKNOWN_TYPE", f"Unknown message type: {kind!r}; allowed: {ALLOWED_TYPES}")

    async def close_idle(self) -> None:
        """Close idle sockets."""
        limit = self._clock() - self.app_state.settings.idle_seconds
        idle = [socket for socket, touched in self.touched.items() if touched < limit]
        for socket in idle:
            del self.touched[socket]
        reason = f"idle for {self.app_state.settings.idle_seconds:g} s: connect again"
        # Concurrently, because each waits until its client has read; some have closed already.
        await asyncio.gather(*[socket.close(GOING_AWAY, reason) for socket in idle], return_exceptions=True)


def _frame(kind: str, data: str) -> str:
    """Return a frame with this JSON as its data."""
    return f'{{"type":"{kind}","data":{data}}}'
