"""OpenEnv's WebSocket protocol: one session per connection.

OpenEnv's own server is not used: a list as a frame ends its session, it reads 16 MiB, drops unknown options silently,
does not close idle sockets, and validates every observation twice in a thread. The frames are equal, and the tests
compare both servers.
"""

import asyncio
import logging
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar, cast

from pydantic import ValidationError
from pydantic_core import to_json
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from drone_env.core.episode import NOT_STARTED, Episode
from drone_env.errors import DroneEnvError, EpisodeError, InvalidValueError, text_of, wrong_parts
from drone_env.llm.prompt import Prompt, get_prompt
from drone_env.models import DroneState, openenv_json
from drone_env.results.sessions import Session, advance, flight_of
from drone_env.server.json_routes import SMALL, TRY_LATER, parse_json, received
from drone_env.server.map_choice import start_episode
from drone_env.server.openenv_text import openenv_fields
from drone_env.server.schemas import OpenEnvReset, RouteAction
from drone_env.server.sessions import ANONYMOUS
from drone_env.server.state import AppState

log = logging.getLogger(__name__)

NORMAL, GOING_AWAY = 1000, 1001
ALLOWED_TYPES = "reset, step, state, close, mcp"
Result = TypeVar("Result")


class RefusedError(Exception):
    """A frame whose response is an error; the session continues.

    Args:
        code: OpenEnv's code.
        message: The message for people.
        more: Further fields of the error, such as `errors`.
    """

    def __init__(self, code: str, message: str, **more: object) -> None:
        super().__init__(message)
        data = {"message": message, "code": code, **more}
        self.frame = _frame("error", to_json(data).decode())


class Connection:
    """The session of a connection.

    Args:
        shared: The parts of the server.
    """

    def __init__(self, shared: AppState) -> None:
        self._shared = shared
        self._session: Session | None = None
        self._episode_id = ""
        self._prompt: Prompt | None = None
        self._last: tuple[float, int] = 0.0, 0

    async def answer(self, received: bytes) -> str | None:
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
        # An action may be a word or a number instead of an object.
        if frame.keys() - {"type", "data"} or not (kind == "step" or isinstance(data, dict)):
            raise RefusedError("VALIDATION_ERROR", "a frame has `type` and `data`, an object, and nothing else")
        try:
            if kind == "step":
                return await self._step(RouteAction.model_validate(data))
            if kind == "reset":
                return await self._reset(OpenEnvReset.model_validate(data))
            if kind == "state":
                state = DroneState.of(self._started().fly()).model_copy(update={"episode_id": self._episode_id})
                return _frame("state", state.model_dump_json())
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

    async def _reset(self, options: OpenEnvReset) -> str:
        """Start an episode. After an error the current one continues."""
        prompt = None if options.prompt is None else get_prompt(options.prompt)
        episode = start_episode(options, None if self._session is None else self._session.seed)
        self._session = Session("", *flight_of(episode), options.agent or ANONYMOUS, episode=episode)
        self._episode_id = options.episode_id if options.episode_id is not None else str(uuid.uuid4())
        self._prompt = prompt
        return await self._shown(episode, None)

    async def _shown(self, episode: Episode, reward: float | None, **metadata: object) -> str:
        # Text takes milliseconds, and some prompts compile code.
        wait = asyncio.to_thread if self._prompt is not None else _at_once
        fields = await wait(openenv_fields, episode, self._prompt, metadata)
        return _frame("observation", openenv_json(episode, reward, **fields))

    def _started(self) -> Session:
        if self._session is None:
            raise EpisodeError(NOT_STARTED)
        return self._session

    async def _step(self, action: RouteAction) -> str:
        session = self._started()
        episode = session.fly()
        # If storing the ended episode failed, the client repeats the last step, and gets the same response.
        if not session.finished:
            self._last = action.fly(episode, lambda one: advance(session, one))
        if session.finished:
            await asyncio.get_running_loop().run_in_executor(self._shared.steps, self._shared.store.keep, session)
        reward, flown = self._last
        return await self._shown(episode, reward, flown=flown)


async def _at_once(function: Callable[..., Result], *arguments: Any) -> Result:
    return function(*arguments)


class OpenEnvSocket:
    """The WebSocket endpoint, an ASGI application. It closes idle sockets.

    Args:
        shared: The parts of the server.
        clock: Returns the time in seconds.
    """

    def __init__(self, shared: AppState, clock: Callable[[], float] = time.monotonic) -> None:
        self.shared = shared
        self._clock = clock
        self.touched: dict[WebSocket, float] = {}
        """Time of the last use of each open socket."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection."""
        socket = WebSocket(scope, receive, send)
        # Clients may disconnect at any time, even before the server accepts them.
        with suppress(WebSocketDisconnect, OSError):
            await socket.accept()
            capacity = self.shared.settings.capacity
            try:
                if "session_id" in socket.query_params:
                    raise RefusedError("SESSION_ERROR", "each connection has its own session: omit session_id")
                if len(self.touched) >= capacity:
                    message = f"{capacity} sessions are open, which is the limit: try again later"
                    raise RefusedError("CAPACITY_REACHED", message)
                self.touched[socket] = self._clock()
                await self._serve(socket)
            except RefusedError as refusal:
                await socket.send_text(refusal.frame)
                await socket.close(TRY_LATER, str(refusal)[:120])
            finally:
                self.touched.pop(socket, None)

    async def _serve(self, socket: WebSocket) -> None:
        connection = Connection(self.shared)
        async for data in received(socket, SMALL):
            if socket not in self.touched:
                return  # closed because it was idle
            self.touched[socket] = self._clock()
            try:
                if data is None:
                    raise RefusedError("INVALID_JSON", "send text frames with JSON")
                answer = await connection.answer(data)
            except RefusedError as refusal:
                answer = refusal.frame
            if answer is None:
                await socket.close(NORMAL)
                return
            if socket not in self.touched:
                return
            await socket.send_text(answer)
            self.touched[socket] = self._clock()

    async def close_idle(self) -> None:
        """Close idle sockets."""
        limit = self._clock() - self.shared.settings.idle_seconds
        idle = [socket for socket, touched in self.touched.items() if touched < limit]
        for socket in idle:
            del self.touched[socket]
        # Concurrently, because each waits for the close frame of its client, which may take seconds.
        await asyncio.gather(*map(self._close_idle, idle))

    async def _close_idle(self, socket: WebSocket) -> None:
        try:
            await socket.close(GOING_AWAY, f"idle for {self.shared.settings.idle_seconds:g} s: connect again")
        except (RuntimeError, WebSocketDisconnect, OSError):
            log.debug("an idle socket was closed already")


def mcp_answer(request: Any) -> dict[str, Any]:
    """Return the JSON-RPC response to an MCP request: this environment has no tools."""
    fields = cast(dict[str, Any], request) if isinstance(request, dict) else {}
    number = fields.get("id")
    answer: dict[str, Any] = {"jsonrpc": "2.0", "id": number if isinstance(number, str | int) else None}
    if fields.get("jsonrpc") != "2.0" or not isinstance(fields.get("method"), str):
        message = 'Invalid Request: a request has "jsonrpc": "2.0" and a method'
        return answer | {"error": {"code": -32600, "message": message}}
    if fields["method"] == "tools/list":
        return answer | {"result": {"tools": []}}
    return answer | {"error": {"code": -32601, "message": "Method not found: this environment has no MCP tools"}}


def _frame(kind: str, data: str) -> str:
    """Return a frame with this JSON as its data."""
    return f'{{"type":"{kind}","data":{data}}}'
