"""What comes in: the frames of a WebSocket, and JSON as the standard has it.

No NaN, no Infinity, no key twice, nothing nested deeply.
"""

import asyncio
import json
from collections import Counter
from collections.abc import AsyncGenerator
from typing import Any, cast

from starlette.websockets import WebSocket, WebSocketState

from drone_env.errors import InvalidValueError

TOO_BIG, TRY_LATER = 1009, 1013
MAX_DEPTH = 32


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is not JSON")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        counts = Counter(name for name, _ in pairs)
        twice = next(name for name, _ in pairs if counts[name] > 1)
        raise ValueError(f"the key {twice!r} stands there twice")
    return found


_DECODER = json.JSONDecoder(parse_constant=_no_constant, object_pairs_hook=_unique)


def parse_json(text: str) -> Any:
    """The value of a JSON text.

    Raises:
        InvalidValueError: if it is not JSON, or nested deeper than `MAX_DEPTH`; the message says what is wrong.
    """
    try:
        value = _DECODER.decode(text)
        if _depth(value) <= MAX_DEPTH:
            return value
    except ValueError as error:
        raise InvalidValueError(f"not JSON: {error}") from None
    except RecursionError:
        pass
    raise InvalidValueError(f"JSON may be nested {MAX_DEPTH} deep")


def _depth(value: Any) -> int:
    if isinstance(value, dict):
        value = list(cast(dict[str, Any], value).values())
    return 1 + max(map(_depth, cast(list[Any], value)), default=0) if isinstance(value, list) else 0


async def received(socket: WebSocket, max_bytes: int) -> AsyncGenerator[str | None, None]:
    """The text of each frame, None for one of bytes, until the socket is closed; one that is too big closes it."""
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect" or socket.application_state is not WebSocketState.CONNECTED:
            return
        text = message.get("text")
        if len(message.get("bytes") or (text or "").encode("utf-8", "surrogatepass")) > max_bytes:
            await socket.close(TOO_BIG, f"a frame may have {max_bytes} bytes")
            return
        yield text
        # Where more has come already, nothing above needs to wait: others get their turn.
        await asyncio.sleep(0)
