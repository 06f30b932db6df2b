"""The requests that were answered: the last ones in memory for `/terminal_logs`, all in a file that cannot grow.

A line says when, what and how long, never a body, a query, a header or a session.
"""

import json
import logging
import os
import sys
import time
from collections import deque
from contextlib import suppress
from datetime import datetime, timezone
from logging.handlers import RotatingFileHandler
from pathlib import Path

from filelock import FileLock
from pydantic import Field
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drone_env import models

log = logging.getLogger(__name__)

KEPT = 200
FILE_NAME = "requests.log"
MAX_BYTES, BACKUPS = 1_000_000, 3
LONGEST_PATH = 200
LOCK_SECONDS = 1.0


class LoggedRequest(models.Message):
    """One answered request."""

    number: int = Field(ge=1, description="Counted since the process started.")
    time: str = Field(description="When it was answered, UTC, ISO 8601.")
    method: str = Field(description="The method, `WEBSOCKET` for a connection.")
    path: str = Field(description="The path, without query.")
    status: int = Field(description="HTTP status; 101 for a WebSocket that was opened, 403 for one that was refused.")
    milliseconds: float = Field(ge=0, description="How long it took; a WebSocket counts when it is closed.")


class _RotatedFile(RotatingFileHandler):
    """A file that several processes write and rotate, and that may not be writable for a while."""

    failing = False

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line; whether that goes wrong is told once, and when it goes well again."""
        self._wrong: BaseException | None = None
        super().emit(record)
        if self.failing != (self._wrong is not None):
            self.failing = not self.failing
            told = f"is not written: {self._wrong}; the server goes on" if self.failing else "is written again"
            log.warning("%s %s", self.baseFilename, told)

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802 - the name is logging's
        """Remember what went wrong."""
        self._wrong = sys.exc_info()[1]

    def shouldRollover(self, record: logging.LogRecord) -> bool:  # noqa: N802
        """Whether this line would make the file too long; a file that another process has rotated is left first."""
        self._follow()
        return bool(super().shouldRollover(record))

    def doRollover(self) -> None:  # noqa: N802
        """Rotate, unless another process has done that meanwhile."""
        with FileLock(f"{self.baseFilename}.lock", LOCK_SECONDS):
            if not self._follow():
                super().doRollover()

    def _follow(self) -> bool:
        """Open the file anew where the one that is open has another name by now, or none; whether that was so."""
        stream = self.stream
        if stream is not None and not stream.closed:
            with suppress(FileNotFoundError):
                if os.path.samestat(os.stat(self.baseFilename), os.fstat(stream.fileno())):
                    return False
            self.stream = None
            stream.close()
        self.stream = self._open()
        return True


class RequestLog:
    """The log of one process."""

    def __init__(self) -> None:
        self.recent: deque[LoggedRequest] = deque(maxlen=KEPT)
        self.count = 0
        self._file: _RotatedFile | None = None

    def open(self, folder: Path, max_bytes: int = MAX_BYTES) -> None:
        """Also write to `requests.log` in this folder, which must exist; other processes may do so, too.

        Args:
            folder: The folder.
            max_bytes: The file is rotated before it grows beyond that.
        """
        self._file = _RotatedFile(
            folder / FILE_NAME, maxBytes=max_bytes, backupCount=BACKUPS, encoding="utf-8", errors="backslashreplace"
        )

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

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
        if self._file is not None:
            line = json.dumps(entry.model_dump())
            self._file.handle(logging.LogRecord(__name__, logging.INFO, "", 0, line, None, None))

    def since(self, number: int) -> list[LoggedRequest]:
        """What is kept of the requests after this one, oldest first."""
        return [entry for entry in self.recent if entry.number > number]


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
        """Pass on, and note what came of it."""
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
