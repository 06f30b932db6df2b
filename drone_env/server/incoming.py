"""Request bodies and WebSocket frames: JSON, parsed once, with bounded work.

A limit of bytes does not bound the work by itself: each wrong list item or unknown key costs a validation error, which
takes a hundred times as long as parsing. So lists in request models stop at the first wrong item (`fail_fast`), and
the number of keys is limited as well.
"""

import asyncio
from collections.abc import AsyncGenerator, Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute
from jiter import from_json
from starlette.requests import ClientDisconnect
from starlette.websockets import WebSocket, WebSocketState

from drone_env.errors import InvalidValueError
from drone_env.server.problems import RequestError

TOO_BIG, TRY_LATER = 1009, 1013
SMALL = 8192
"""Bytes of a body or frame unless it says otherwise: enough for the longest valid reset with all text escaped."""
LARGE = 131_072
"""Bytes of one that carries a record, an observation or a map; jiter parses the worst of that size in 3 ms."""
LIMIT = "x-max-bytes"
"""Key of the limit in the OpenAPI description of a route."""
LARGE_BODY = {LIMIT: LARGE}
"""`openapi_extra` of a route with a large body."""
MOST_PARTS = 500
"""Lists, objects and keys of a body or frame, where the largest map needs 170. 40,000 new lists start a full garbage
collection, which takes 60 ms, and each unknown key is a validation error. Characters in strings count, too."""


def parse_json(data: bytes) -> Any:
    """The value of a JSON text. NaN, Infinity, duplicate keys, lone surrogates and nesting beyond 200 are errors.

    Raises:
        InvalidValueError: if it is not JSON, or has too many parts; the message says what is wrong.
    """
    if data.count(b"[") + data.count(b"{") + data.count(b":") > MOST_PARTS:
        raise InvalidValueError(f"JSON may have {MOST_PARTS} lists, objects and keys here")
    try:
        return from_json(data, allow_inf_nan=False, catch_duplicate_keys=True)
    except ValueError as error:
        raise InvalidValueError(f"not JSON: {error}") from None


class JsonRequest(Request):
    """A request whose body has been read and parsed."""

    content = b""
    value: Any = None

    async def read(self, most: int) -> None:
        """Read and parse the body.

        Args:
            most: Bytes that it may have.

        Raises:
            RequestError: if it is too large, not declared as JSON, or not JSON.
        """
        body = bytearray()
        try:
            async for piece in self.stream():
                body += piece
                if len(body) > most:
                    detail = f"the body of {self.url.path} may have {most} bytes"
                    raise RequestError(413, "too_large", detail, {"Connection": "close"})
        except ClientDisconnect:
            raise RequestError(400, "not_json", "the connection ended before the body did") from None
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

    async def body(self) -> bytes:
        """The bytes of the body, for FastAPI."""
        return self.content

    async def json(self) -> Any:
        """The value of the body, for FastAPI, which validates it."""
        return self.value


class JsonRoute(APIRoute):
    """A route that reads and parses a body once, within the limit in its OpenAPI description.

    Every router with bodies needs this `route_class`; a test over the description finds one without.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        if self.body_field is not None:
            self.openapi_extra = {LIMIT: SMALL, **(self.openapi_extra or {})}

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """What answers a request."""
        answer = super().get_route_handler()
        if self.body_field is None:
            return answer

        async def handle(request: Request) -> Response:
            with_body = JsonRequest(request.scope, request.receive)
            await with_body.read((self.openapi_extra or {})[LIMIT])
            return await self.answer(with_body, answer)

        return handle

    async def answer(
        self, request: JsonRequest, validated: Callable[[Request], Coroutine[Any, Any, Response]]
    ) -> Response:
        """The answer to a request whose body has been parsed.

        Args:
            request: The request.
            validated: FastAPI's way to it.
        """
        return await validated(request)


async def received(socket: WebSocket, most: int) -> AsyncGenerator[bytes | None, None]:
    """The bytes of each text frame, None for a binary one, until the socket is closed; one that is too big closes it.

    Args:
        socket: The socket.
        most: Bytes that a frame may have.
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
        # Where more has come already, nothing above needs to wait: others get their turn.
        await asyncio.sleep(0)
