"""The last requests that were answered: `/terminal_logs` and the page show them.

An entry says when, what and how long, never a body, a query, a header or a session.
"""

import asyncio
import time
from collections import deque
from collections.abc import AsyncGenerator
from datetime import datetime, timezone

from pydantic import Field
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drone_env import models

KEPT = 200
LONGEST_PATH = 200
BATCH_SECONDS = 0.25
"""Followers receive the requests of this time together."""


class LoggedRequest(models.Message):
    """One answered request."""

    number: int = Field(ge=1, description="Counted since the process started.")
    time: str = Field(description="When it was answered, UTC, ISO 8601.")
    method: str = Field(description="The method, `WEBSOCKET` for a connection.")
    path: str = Field(description="The path, without query.")
    status: int = Field(description="HTTP status; 101 for a WebSocket that was opened, 403 for one that was refused.")
    milliseconds: float = Field(ge=0, description="How long it took; a WebSocket counts when it is closed.")


class RequestLog:
    """The log of one process."""

    def __init__(self) -> None:
        self.recent: deque[LoggedRequest] = deque(maxlen=KEPT)
        self.count = 0
        self.followers = 0
        self._changed = asyncio.Event()
        self._batch: tuple[int, int, bytes] = (0, 0, b"")

    def add(self, method: str, path: str, status: int, seconds: float) -> None:
        """Note one answer."""
        self.count += 1
        entry = LoggedRequest(
            number=self.count,
            time=datetime.now(timezone.utc).isoformat(timespec="milliseconds"),
            method=method,
            path=path[:LONGEST_PATH],
            status=status,
            milliseconds=round(seconds * 1000, 3),
        )
        self.recent.append(entry)
        self._changed.set()

    def since(self, number: int) -> list[LoggedRequest]:
        """What is kept of the requests after this one, oldest first."""
        return [entry for entry in self.recent if entry.number > number]

    async def follow(self) -> AsyncGenerator[bytes, None]:
        """Server-sent events of the requests, at first those that are kept."""
        seen = 0
        while True:
            if seen == self.count:
                self._changed.clear()
                await self._changed.wait()
                await asyncio.sleep(BATCH_SECONDS)
            start, seen = seen, self.count
            yield self._events(start)

    def _events(self, start: int) -> bytes:
        """The events after this number, written once for all followers that are equally far."""
        if self._batch[:2] != (start, self.count):
            lines = [f"id: {one.number}\r\ndata: {one.model_dump_json()}\r\n\r\n" for one in self.since(start)]
            self._batch = start, self.count, "".join(lines).encode()
        return self._batch[2]


class LogRequests:
    """Middleware that notes every answer.

    Args:
        app: The application within.
        log: Where to.
    """

    def __init__(self, app: ASGIApp, log: RequestLog) -> None:
        self.app = app
        self.log = log

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, and note the result."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        is_http = scope["type"] == "http"
        started = time.perf_counter()
        status = 500 if is_http else 403

        async def noting(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            elif message["type"] == "websocket.accept":
                status = 101
            await send(message)

        try:
            await self.app(scope, receive, noting)
        finally:
            method = scope["method"] if is_http else "WEBSOCKET"
            self.log.add(method, scope["path"], status, time.perf_counter() - started)
