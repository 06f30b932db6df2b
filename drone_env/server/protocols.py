"""Limits of each connection, on top of uvicorn's protocols.

uvicorn bounds neither the head of a request nor the time for it, and refuses new connections while unused ones are
open. It parses all received requests and frames at once, and answers pings to clients that do not read.
"""

import asyncio
import logging
import time
from collections import Counter
from typing import Any

from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

log = logging.getLogger(__name__)

REQUEST_SECONDS = 30.0
"""Time for a whole request to arrive."""
HEAD_BYTES = 16_384
"""Most bytes of a request outside its body; browsers and proxies send about a tenth of that. What arrives in one piece
with the end of a request is not counted.
"""
END_OF_HEAD = b"\r\n\r\n"
PIECE = 256
"""Bytes of a WebSocket that are parsed at once: up to 42 frames."""


class Http(HttpToolsProtocol):
    """HTTP/1.1 with limits of the size and time of a request, on `limit_concurrency` connections."""

    request_seconds = REQUEST_SECONDS

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Accept the connection, or refuse it if there are too many."""
        super().connection_made(transport)
        self._deadline: asyncio.TimerHandle | None = None
        self._unread = bytearray()
        self._head_bytes = 0
        self.address = "" if self.client is None else self.client[0]
        """The address of the other side."""
        self._used_at = time.monotonic()
        # uvicorn would refuse requests while the tasks of closed connections end.
        most, self.limit_concurrency = self.limit_concurrency, None
        others = len(self.connections) - 1
        if most is not None and others >= most - 1:
            log.warning("%d connections are open, which is the limit: unused ones are closed", others)
            if not self._make_room():
                self._end(503, "too many connections are open", b"retry-after: 5\r\n")
                return
        self._limit_time()

    @property
    def answering(self) -> bool:
        """Whether a whole request has arrived, and its response is not complete."""
        cycle: Any = self.cycle
        return bool(self.pipeline) or (cycle is not None and not cycle.more_body and not cycle.response_complete)

    def data_received(self, data: bytes) -> None:
        """Parse data, or buffer it during a response."""
        self._used_at = time.monotonic()
        self._unread += data
        self._read()

    def on_body(self, body: bytes) -> None:
        """Add a chunk of a body."""
        self._head_bytes -= len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        """End the request."""
        self._head_bytes = 0
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Continue with the next request, which may have arrived already."""
        super().on_response_complete()
        self._read()

    def send_400_response(self, msg: str) -> None:
        """Refuse a request that the parser does not understand."""
        self._end(400, "this is not a valid HTTP request")

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        super().connection_lost(exc)
        self._limit_time()

    def _read(self) -> None:
        """Parse data until a request is complete. The end of its response continues with the next."""
        while self._unread and not self.answering and self.transport.get_protocol() is self:
            if self.transport.is_closing():
                return
            # uvicorn would parse all further requests, too.
            found = self._unread.find(END_OF_HEAD)
            end = len(self._unread) if found < 0 else found + len(END_OF_HEAD)
            piece = bytes(self._unread[:end])
            del self._unread[:end]
            self._head_bytes += len(piece)
            super().data_received(piece)
            if self._head_bytes > HEAD_BYTES and not self.transport.is_closing():
                self._end(431, f"a request has at most {HEAD_BYTES} bytes outside its body")
        # Without `flow`: whenever the application receives, uvicorn resumes what that has paused.
        if not self.transport.is_closing():
            self.transport.pause_reading() if self._unread else self.transport.resume_reading()
        self._limit_time()

    def _unsupported_upgrade_warning(self) -> None:
        # The request is answered without the upgrade. The parser cannot read another request after it.
        self.cycle.keep_alive = False

    def _make_room(self) -> bool:
        """Close the longest unused connection of the address with the most, and return whether there was one."""
        others = [other for other in self.connections if isinstance(other, Http) and other is not self]
        unused = [other for other in others if not other.answering]
        counts = Counter(other.address for other in unused)
        if not unused:
            return False
        closed = min(unused, key=lambda other: (-counts[other.address], other._used_at))
        self.connections.discard(closed)  # the transport reports the loss later
        closed.transport.close()
        return True

    def _end(self, status: int, text: str, header: bytes = b"") -> None:
        """Send a status, unless a response has started, and close the connection."""
        cycle: Any = self.cycle
        if cycle is None or cycle.response_complete or not cycle.response_started:
            about = b"content-type: text/plain\r\ncontent-length: %d\r\nconnection: close\r\n" % len(text)
            self.transport.write(STATUS_LINE[status] + about + header + b"\r\n" + text.encode("ascii"))
        self.transport.close()

    def _limit_time(self) -> None:
        """Limit the time of a request. Between requests, `timeout_keep_alive` limits it."""
        if self in self.connections and self.timeout_keep_alive_task is None and not self.answering:
            if self._deadline is None:
                self._deadline = self.loop.call_later(
                    self.request_seconds, self._end, 408, f"a request has {self.request_seconds:g} s to arrive"
                )
        elif self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None


class WebSockets(WebSocketsSansIOProtocol):
    """WebSockets: parses a piece at a time, and only while the application receives and the client reads."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start with an empty buffer."""
        super().connection_made(transport)
        self._unread = bytearray()
        self._turn: asyncio.Handle | None = None

    def data_received(self, data: bytes) -> None:
        """Parse the head of the request, which the first call contains completely, or buffer data."""
        if self.handshake_initiated:
            self._unread += data
            self._go_on()
            return
        super().data_received(data)
        if not self.handshake_initiated:  # a head with a body or a line over 8 KB gets no response from uvicorn
            self.transport.write(b"".join(self.conn.data_to_send()))
            self.transport.close()

    async def receive(self) -> Any:
        """Return the next message for the application."""
        message = await super().receive()
        self._go_on()
        return message

    async def send(self, message: Any) -> None:
        """Send a message of the application.

        Raises:
            ClientDisconnected: if the connection is being closed, for example after a frame that is too large.
        """
        await self.writable.wait()
        if self.close_sent or self.transport.is_closing():
            raise ClientDisconnected
        await super().send(message)
        self._go_on()

    def resume_writing(self) -> None:
        """Go on when the client has read."""
        super().resume_writing()
        self._go_on()

    def shutdown(self) -> None:
        """Send a close frame, and close the connection."""
        if not self.transport.is_closing():
            super().shutdown()

    def _go_on(self) -> None:
        """Schedule the next piece, or resume reading."""
        if self.transport.is_closing():
            return
        if self._unread:
            self.transport.pause_reading()
            if self._may_parse() and self._turn is None:
                self._turn = self.loop.call_soon(self._take_turn)
        elif self._may_parse():
            self.transport.resume_reading()

    def _take_turn(self) -> None:
        """Parse one piece. Other tasks run before the next."""
        self._turn = None
        if self._may_parse() and not self.transport.is_closing():
            piece = bytes(self._unread[:PIECE])
            del self._unread[:PIECE]
            super().data_received(piece)
        self._go_on()

    def _may_parse(self) -> bool:
        return self.handshake_complete and not self.read_paused and self.writable.is_set()
