"""OpenEnv's WebSocket: one session per connection, speaking the protocol of OpenEnv's own server.

That server would do, but for what it does with frames that nobody planned for (a list ends the session, 16 MiB are
read, unknown options are dropped without a word), with idle sessions (the slot is freed, the socket is not), and with
time: it validates every observation twice, in a thread of its own. The frames are the same, and the tests hold both
servers side by side.
"""

import asyncio
import logging
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any, cast

from pydantic import ValidationError
from pydantic_core import to_json
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from drone_env.episodes.store import Store
from drone_env.errors import DroneEnvError, InvalidValueError
from drone_env.server.openenv.session import Flight
from drone_env.server.problems import printable, where
from drone_env.server.schemas import ResetOptions, WireAction
from drone_env.server.sessions import ANONYMOUS
from drone_env.server.strict_json import parse_json

log = logging.getLogger(__name__)

NORMAL, GOING_AWAY, TOO_BIG, TRY_LATER = 1000, 1001, 1009, 1013
ALLOWED_TYPES = "reset, step, state, close, mcp"


class RefusedError(Exception):
    """A frame that is answered with an error; the session goes on.

    Args:
        code: OpenEnv's code.
        message: What is wrong, for people.
        errors: The parts that are wrong.
    """

    def __init__(self, code: str, message: str, errors: list[dict[str, Any]] | None = None) -> None:
        self.code = code
        self.errors = errors
        super().__init__(message)


class Connection:
    """One open socket and its session."""

    def __init__(self, socket: WebSocket, now: float) -> None:
        self.socket = socket
        self.flight = Flight()
        self.touched = now


class OpenEnvSocket:
    """The WebSocket endpoint: an ASGI application.

    Args:
        store: Gives the store where finished episodes go, once the server has started.
        capacity: How many sockets may be open.
        idle_seconds: A socket on which nothing arrives for so long is closed.
        max_bytes: The largest frame.
        clock: What tells the time in seconds, since whenever.
    """

    def __init__(
        self,
        store: Callable[[], Store],
        capacity: int,
        idle_seconds: float,
        max_bytes: int,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.store = store
        self.capacity = capacity
        self.idle_seconds = idle_seconds
        self.max_bytes = max_bytes
        self._clock = clock
        self.connections: set[Connection] = set()
        # One thread: the store lets one writer in at a time anyway.
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="episodes")

    def close(self) -> None:
        """Wait for what is being written."""
        self._writer.shutdown()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one connection to its end."""
        socket = WebSocket(scope, receive, send)
        await socket.accept()
        # Where the other side has gone there is nobody left to tell.
        with suppress(WebSocketDisconnect, OSError):
            await self._admit(socket)

    async def _admit(self, socket: WebSocket) -> None:
        if "session_id" in socket.query_params:
            refusal = RefusedError("SESSION_ERROR", "every connection has a session of its own: leave out session_id")
        elif len(self.connections) >= self.capacity:
            refusal = RefusedError(
                "CAPACITY_REACHED", f"{self.capacity} sessions are open, and no more are allowed: try again later"
            )
        else:
            connection = Connection(socket, self._clock())
            self.connections.add(connection)
            try:
                await self._serve(connection)
            finally:
                self.connections.discard(connection)
            return
        await socket.send_text(_error(refusal))
        await socket.close(TRY_LATER, str(refusal)[:120])

    async def _serve(self, connection: Connection) -> None:
        socket, clock = connection.socket, self._clock
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            connection.touched = clock()
            text = message.get("text")
            if _is_longer(text or message.get("bytes") or "", self.max_bytes):
                await socket.close(TOO_BIG, f"a frame may have {self.max_bytes} bytes")
                return
            try:
                if text is None:
                    raise RefusedError("INVALID_JSON", "send text frames with JSON")
                answer = await self._answer(connection.flight, text)
            except RefusedError as refusal:
                answer = _error(refusal)
            if answer is None:
                await socket.close(NORMAL)
                return
            if connection not in self.connections:
                return  # closed as idle meanwhile
            await socket.send_text(answer)
            connection.touched = clock()
            # Where more has come already, nothing above needs to wait: others get their turn.
            await asyncio.sleep(0)

    async def _answer(self, flight: Flight, text: str) -> str | None:
        """The answer to a frame, None where it asks to close.

        Raises:
            RefusedError: if the frame cannot be answered.
        """
        try:
            frame = parse_json(text)
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
                return await self._step(flight, data)
            if kind == "reset":
                flight.reset(ResetOptions.model_validate(data))
                return _frame("observation", flight.result(None))
            if kind == "state":
                return _frame("state", flight.state())
        except ValidationError as error:
            errors = [{"loc": [printable(where(e["loc"]))], "msg": e["msg"], "type": e["type"]} for e in error.errors()]
            told = "; ".join(f"{e['loc'][0] or 'data'}: {e['msg']}" for e in errors[:5])
            raise RefusedError("VALIDATION_ERROR", f"Invalid message: {told}", errors[:20]) from None
        except LookupError as error:
            raise RefusedError("VALIDATION_ERROR", str(error)) from None
        except DroneEnvError as error:
            raise RefusedError("EXECUTION_ERROR", str(error)) from None
        if kind == "close":
            return None
        if kind == "mcp":
            return _frame("mcp", to_json(mcp_answer(data)).decode())
        raise RefusedError("UNKNOWN_TYPE", f"Unknown message type: {kind!r}; allowed: {ALLOWED_TYPES}")

    async def _step(self, flight: Flight, data: dict[str, Any]) -> str:
        action = WireAction.model_validate(data).action
        episode = flight.episode
        # Ended and not kept, it has answered an error: the same step again is answered as it would have been.
        again = episode.ended and not flight.stored
        reward = episode.reward_last if again else episode.step(action)
        if episode.ended and not flight.stored:
            # Answered when it is kept. A step after a failure tries again.
            agent = flight.agent or ANONYMOUS
            await asyncio.get_running_loop().run_in_executor(self._writer, self.store().add_episode, episode, agent)
            flight.stored = True
        return _frame("observation", flight.result(reward))

    async def close_idle(self) -> None:
        """Close the sockets that were idle for too long."""
        limit = self._clock() - self.idle_seconds
        idle = {connection for connection in self.connections if connection.touched < limit}
        self.connections -= idle
        # All at once: each waits for its client to say goodbye, which may take seconds.
        await asyncio.gather(*[self._close_idle(connection.socket) for connection in idle])

    async def _close_idle(self, socket: WebSocket) -> None:
        try:
            await socket.close(GOING_AWAY, f"idle for {self.idle_seconds:g} s: connect again")
        except (RuntimeError, WebSocketDisconnect, OSError):
            log.debug("an idle socket had been closed already")


def mcp_answer(request: Any) -> dict[str, Any]:
    """The JSON-RPC answer to any MCP request: this environment has no tools."""
    asked = cast(dict[str, Any], request) if isinstance(request, dict) else {}
    valid = asked.get("jsonrpc") == "2.0" and isinstance(asked.get("method"), str)
    number = asked.get("id")
    echoed = printable(number) if isinstance(number, str) else number if isinstance(number, int) else None
    answer: dict[str, Any] = {"jsonrpc": "2.0", "id": echoed}
    if not valid:
        message = 'a request has "jsonrpc": "2.0" and a method'
        return answer | {"error": {"code": -32600, "message": f"Invalid Request: {message}"}}
    if asked["method"] == "tools/list":
        return answer | {"result": {"tools": []}}
    return answer | {"error": {"code": -32601, "message": "Method not found: this environment has no MCP tools"}}


def _is_longer(frame: str | bytes, most: int) -> bool:
    """Whether a frame has more bytes; one of ASCII need not be encoded to be counted."""
    if isinstance(frame, str) and not frame.isascii():
        return len(frame) > most or len(frame.encode("utf-8", "surrogatepass")) > most
    return len(frame) > most


def _frame(kind: str, data: str) -> str:
    """A frame around the JSON of its data."""
    return f'{{"type":"{kind}","data":{data}}}'


def _error(refusal: RefusedError) -> str:
    data: dict[str, Any] = {"message": printable(str(refusal)), "code": refusal.code}
    if refusal.errors is not None:
        data["errors"] = refusal.errors
    return _frame("error", to_json(data).decode())
