"""The request log, for `/terminal_logs` and the page, and the training log.

The request log contains no bodies, queries, headers or sessions.
"""

import asyncio
from collections import deque
from collections.abc import AsyncGenerator
from datetime import datetime, timezone
from functools import cached_property
from math import isfinite
from pathlib import Path
from urllib.parse import quote

from pydantic import Field

from drone_env import models
from drone_env.errors import InvalidValueError, StoreError
from drone_env.files import open_file, stamp

KEPT = 200
LONGEST_PATH = 200
BATCH_SECONDS = 0.25
"""Event streams send the requests of this time together."""


class LoggedRequest(models.Message):
    """One request."""

    number: int = Field(ge=1, description="Number of the request since the process started.")
    time: str = Field(description="Time of the response, UTC, ISO 8601.")
    method: str = Field(description="The method, `WEBSOCKET` for a connection.")
    path: str = Field(description="The path, without query.")
    status: int = Field(description="HTTP status; 101 for an opened WebSocket, 403 for a refused one.")
    milliseconds: float = Field(ge=0, description="Duration; a WebSocket is logged when it is closed.")

    @cached_property
    def event(self) -> bytes:
        """The server-sent event of the request. Cached, because all streams share it."""
        return f"id: {self.number}\r\ndata: {self.model_dump_json()}\r\n\r\n".encode()


class RequestLog:
    """The request log of one process."""

    def __init__(self) -> None:
        self.recent: deque[LoggedRequest] = deque(maxlen=KEPT)
        self.count = 0
        self.followers = 0
        self._changed = asyncio.Event()

    def add(self, method: str, path: str, status: int, seconds: float) -> None:
        """Add a request."""
        self.count += 1
        entry = LoggedRequest(
            number=self.count,
            time=datetime.now(timezone.utc).isoformat(timespec="milliseconds"),
            method=method,
            # Control characters, and those that change the direction of text, as they were sent.
            path="".join(one if one.isprintable() else quote(one, errors="replace") for one in path[:LONGEST_PATH]),
            status=status,
            milliseconds=round(seconds * 1000, 3),
        )
        self.recent.append(entry)
        self._changed.set()

    def since(self, number: int) -> list[LoggedRequest]:
        """Return the stored requests after a number, oldest first."""
        return [entry for entry in self.recent if entry.number > number]

    async def follow(self) -> AsyncGenerator[bytes, None]:
        """Yield server-sent events of the stored requests, and then of new ones."""
        sent = 0
        while True:
            if sent == self.count:
                self._changed.clear()
                await self._changed.wait()
                await asyncio.sleep(BATCH_SECONDS)
            start, sent = sent, self.count
            yield b"".join([entry.event for entry in self.since(start)])


FILE_NAME = "train.log"
TAIL_BYTES = 256 * 1024
CURVE_BYTES = 32 * 1024 * 1024
POINTS = 400


class TrainLog:
    """The training log in a data folder; it may be missing.

    Args:
        folder: The data folder.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / FILE_NAME
        self._stamp: object = False

    def has_changed(self) -> bool:
        """Return whether the file has changed since the last call; true for the first call."""
        before, self._stamp = self._stamp, stamp(self.path)
        return self._stamp != before

    def tail(self, lines: int) -> list[str]:
        """Return the last lines, oldest first, from at most 256 KiB. Empty without a file."""
        return list(deque(self._end(TAIL_BYTES), lines))

    def curve(self) -> dict[str, list[float | None]]:
        """Return the metrics of the training by name; empty without a file.

        It reads at most 32 MiB and samples at most 400 lines evenly, including the last. Lines consist of `name=value`,
        as `drone_env.rl.run.log_line` writes them; lines with other names than the first are skipped.
        """
        lines = self._end(CURVE_BYTES)
        sample = lines[:: -max(1, -(-len(lines) // POINTS))][::-1]
        rows = [row for row in map(_metrics, sample) if row]
        return {name: [row[name] for row in rows if row.keys() == rows[0].keys()] for name in rows[0]} if rows else {}

    def _end(self, size: int) -> list[str]:
        """Return the last lines, of at most `size` bytes. Empty without a file.

        Raises:
            StoreError: if it cannot be read.
        """
        try:
            with open_file(self.path) as file:
                start = max(file.seek(0, 2) - size, 0)
                file.seek(start)
                text = file.read(size).decode("utf-8", "replace")
        except FileNotFoundError:
            return []
        except (InvalidValueError, OSError) as error:
            why = getattr(error, "strerror", None) or str(error).removeprefix(f"{self.path} ")
            raise StoreError(f"{FILE_NAME} cannot be read: {why}") from None
        return text.splitlines()[1 if start else 0 :]


def _metrics(line: str) -> dict[str, float | None]:
    """Return the metrics of a line; empty if it has none."""
    parts = [part.partition("=") for part in line.split()]
    try:
        values = [None if value == "-" else float(value) for _, _, value in parts]
    except ValueError:
        return {}
    # JSON has no NaN.
    finite = [value if value is not None and isfinite(value) else None for value in values]
    return {name: value for (name, _, _), value in zip(parts, finite, strict=True)}
