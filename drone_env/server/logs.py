"""The request log, for `/terminal_logs` and the page. It contains no bodies, queries, headers or sessions."""

import asyncio
from collections import deque
from collections.abc import AsyncGenerator
from datetime import datetime, timezone
from functools import lru_cache
from time import time
from urllib.parse import quote

from pydantic import Field

from drone_env import models

KEPT = 200
LONGEST_PATH = 200
BATCH_SECONDS = 0.25
"""Event streams send the requests of this time together."""


class LoggedRequest(models.StrictModel):
    """One request."""

    number: int = Field(ge=1, description="Number of the request since the process started.")
    time: str = Field(description="Time of the response, UTC, ISO 8601.")
    method: str = Field(description="The method, `WEBSOCKET` for a connection.")
    path: str = Field(description="The path, without query.")
    status: int = Field(description="HTTP status; 101 for an opened WebSocket, 403 for a refused one.")
    milliseconds: float = Field(ge=0, description="Duration; a WebSocket is logged when it is closed.")


Entry = tuple[int, float, str, str, int, float]
"""Number, time, method, path, status and duration of a request."""


@lru_cache(maxsize=KEPT)
def _logged(entry: Entry) -> tuple[LoggedRequest, bytes]:
    """Return a request and its server-sent event. Cached, because all streams share it."""
    number, at, method, path, status, seconds = entry
    if not path.isprintable():
        # Control characters, and those that change the direction of text, as they were sent.
        path = "".join(one if one.isprintable() else quote(one, errors="replace") for one in path)
    request = LoggedRequest(
        number=number,
        time=datetime.fromtimestamp(at, timezone.utc).isoformat(timespec="milliseconds"),
        method=method,
        path=path,
        status=status,
        milliseconds=round(seconds * 1000, 3),
    )
    return request, f"id: {number}\r\ndata: {request.model_dump_json()}\r\n\r\n".encode()


class RequestLog:
    """The request log of one process."""

    def __init__(self) -> None:
        self._recent: deque[Entry] = deque(maxlen=KEPT)
        self.count = 0
        self._changed = asyncio.Event()

    def add(self, method: str, path: str, status: int, seconds: float) -> None:
        """Add a request."""
        self.count += 1
        self._recent.append((self.count, time(), method, path[:LONGEST_PATH], status, seconds))
        self._changed.set()

    def since(self, number: int) -> list[LoggedRequest]:
        """Return the stored requests after a number, oldest first."""
        return [_logged(entry)[0] for entry in self._recent if entry[0] > number]

    async def follow(self) -> AsyncGenerator[bytes, None]:
        """Yield server-sent events of the stored requests, and then of new ones."""
        sent = 0
        while True:
            if sent == self.count:
                self._changed.clear()
                await self._changed.wait()
                await asyncio.sleep(BATCH_SECONDS)
            start, sent = sent, self.count
            yield b"".join([_logged(entry)[1] for entry in self._recent if entry[0] > start])
