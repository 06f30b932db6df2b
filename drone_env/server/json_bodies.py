"""JSON in request bodies and WebSocket frames, parsed once and of bounded size.

A byte limit alone does not bound the cost: each invalid list item is a validation error, which takes a hundred times as
long as parsing. So lists in request models stop at the first invalid item (`fail_fast`).
"""

import asyncio
from collections.abc import AsyncGenerator
from typing import Any

from fastapi import Request
from jiter import from_json
from starlette.types import Message
from starlette.websockets import WebSocket, WebSocketState

from drone_env.errors import InvalidValueError
from drone_env.server.exceptions import RequestError

TOO_BIG, TRY_LATER = 1009, 1013
LARGEST_BODY = 131_072
"""Limit of a body in bytes: enough for a record or a map. jiter parses any text of that size within 3 ms."""


def parse_json(data: bytes | None) -> Any:
    """Parse JSON. NaN, Infinity, duplicate keys, lone surrogates and nesting beyond 200 are errors.

    Args:
        data: The text; None for a binary frame.

    Raises:
        InvalidValueError: if it is not JSON.
    """
    if data is None:
        raise InvalidValueError("this is a binary frame: send text frames with JSON")
    try:
        return from_json(data, allow_inf_nan=False, catch_duplicate_keys=True)
    except ValueError as error:
        raise InvalidValueError(f"not JSON: {error}") from None


class JsonRequest(Request):
    """A request whose body is read and parsed before the application reads it.

    Attributes:
        content: The body.
        value: The parsed body; None if it is empty.
    """

    content = b""
    value: Any = None
    _told = False

    async def read(self) -> None:
        """Read and parse the body.

        Raises:
            RequestError: if the body is too large, has another content type, or is not JSON.
        """
        body, message = bytearray(), {"more_body": True}
        while message.get("more_body"):
            message = await self.receive()
            if message["type"] == "http.disconnect":
                raise RequestError(400, "not_json", "the connection ended before the body did")
            body += message.get("body", b"")
            if len(body) > LARGEST_BODY:
                detail = f"a body may have {LARGEST_BODY} bytes"
                raise RequestError(413, "too_large", detail, {"Connection": "close"})
        if not body:
            return
        kind = self.headers.get("content-type", "").partition(";")[0].strip().lower()
        if kind != "application/json":
            detail = f"a body must be declared as Content-Type: application/json, got {kind!r}"
            raise RequestError(415, "content_type", detail)
        self.content = bytes(body)
        try:
            self.value = parse_json(self.content)
        except InvalidValueError as error:
            raise RequestError(400, "not_json", str(error)) from None

    async def again(self) -> Message:
        """The ASGI messages of the request once more, for the application."""
        if self._told:
            return await self.receive()
        self._told = True
        return {"type": "http.request", "body": self.content}


async def received(socket: WebSocket, most: int) -> AsyncGenerator[bytes | None, None]:
    """Yield the bytes of each text frame, and None for a binary frame, until the socket is closed.

    Args:
        socket: The socket. A frame that is too large closes it.
        most: The limit of a frame in bytes.
    """
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect" or socket.application_state is not WebSocketState.CONNECTED:
            return
        text: str | None = message.get("text")
        data = (message.get("bytes") or b"") if text is None else text.encode("utf-8", "surrogatepass")
        if len(data) > most:
            await socket.close(TOO_BIG, f"a frame may have {most} bytes")
            return
        yield None if text is None else data
        # If the next frame is here already, nothing above waits, so other tasks would starve.
        await asyncio.sleep(0)
