"""The requests that were answered: the last ones in memory for `/terminal_logs`, all in a file that cannot grow.

A line says when, what and how long, never a body, a query, a header or a session.
"""

import json
import logging
import os
import time
from collections import deque
from contextlib import suppress
from datetime import datetime, timezone
from io import FileIO
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


FIELDS = tuple(LoggedRequest.model_fields)


class _RotatedFile:
    """A file of lines that several processes write and rotate, and that may not be writable for a while.

    Two questions to the system for a line: `logging` asks seven, and takes as long as all the rest of a short request.
    """

    def __init__(self, path: Path, max_bytes: int) -> None:
        self._path = path
        self._max_bytes = max_bytes
        self._file: FileIO | None = None
        self._opened: tuple[int, int] | None = None
        self._rest = b""
        self._failing = False
        self._open()

    def write(self, line: str) -> None:
        """Write a line; whether that goes wrong is told once, and when it goes well again."""
        wrong: OSError | None = None
        try:
            self._write(line.encode("ascii", "backslashreplace"))
        except OSError as error:
            wrong = error
        if self._failing != (wrong is not None):
            self._failing = not self._failing
            told = f"is not written: {wrong}; the server goes on" if self._failing else "is written again"
            log.warning("%s %s", self._path, told)

    def close(self) -> None:
        """Close it."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _write(self, line: bytes) -> None:
        file = self._with_room(len(line))
        if file is None:
            with FileLock(f"{self._path}.lock", LOCK_SECONDS):
                # Another process may have rotated it meanwhile.
                file = self._with_room(len(line)) or self._rotate()
        data = self._rest + line
        # A full disk may take a part of a line: the rest goes before what is written next.
        self._rest = data[file.write(data) :]

    def _with_room(self, length: int) -> FileIO | None:
        """The file, opened anew where another lies at its path by now; None where it has no room for so much."""
        with suppress(FileNotFoundError):
            found = os.stat(self._path)
            if self._file is not None and (found.st_dev, found.st_ino) == self._opened:
                return self._file if found.st_size + length <= self._max_bytes else None
        file = self._open()
        return file if os.fstat(file.fileno()).st_size + length <= self._max_bytes else None

    def _rotate(self) -> FileIO:
        self.close()
        for number in range(BACKUPS, 0, -1):
            older = f"{self._path}.{number - 1}" if number > 1 else self._path
            with suppress(FileNotFoundError):
                os.replace(older, f"{self._path}.{number}")
        return self._open()

    def _open(self) -> FileIO:
        self.close()
        self._rest = b""
        self._file = FileIO(self._path, "a")
        opened = os.fstat(self._file.fileno())
        self._opened = (opened.st_dev, opened.st_ino)
        return self._file


class RequestLog:
    """The log of one process."""

    def __init__(self) -> None:
        self._recent: deque[tuple[int, str, str, str, int, float]] = deque(maxlen=KEPT)
        self.count = 0
        self._file: _RotatedFile | None = None

    def open(self, folder: Path, max_bytes: int = MAX_BYTES) -> None:
        """Also write to `requests.log` in this folder, which must exist; other processes may do so, too.

        Args:
            folder: The folder.
            max_bytes: The file is rotated before it grows beyond that.
        """
        self._file = _RotatedFile(folder / FILE_NAME, max_bytes)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def add(self, method: str, path: str, status: int, seconds: float) -> None:
        """Note one answer."""
        self.count += 1
        now = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
        entry = (self.count, now, method, path[:LONGEST_PATH], status, round(seconds * 1000, 3))
        self._recent.append(entry)
        if self._file is not None:
            self._file.write(json.dumps(dict(zip(FIELDS, entry, strict=True))) + "\n")

    def since(self, number: int) -> list[LoggedRequest]:
        """What is kept of the requests after this one, oldest first."""
        fields = [dict(zip(FIELDS, entry, strict=True)) for entry in self._recent if entry[0] > number]
        return [LoggedRequest.model_validate(entry) for entry in fields]


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
