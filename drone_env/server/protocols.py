"""How a process serves its connections: uvicorn's protocols, with an end for callers that never come to one.

Of uvicorn's parsers h11 is taken. httptools spares an HTTP step a few percent of its time, but hands on all that can be
parsed: one caller that sends requests and reads no answers fills the memory with them, and a header line may have any
length.
"""

import asyncio
import logging
import time
from typing import Any

import h11
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

log = logging.getLogger(__name__)

REQUEST_SECONDS = 30.0
"""A request is here as a whole after so long, and a new connection has sent one."""
END_SECONDS = 4.0
"""What callers have not read so long after the server was asked to end is thrown away."""
WARNING_SECONDS = 60.0
TIMED_OUT = b"HTTP/1.1 408 Request Timeout\r\nconnection: close\r\ncontent-length: 0\r\n\r\n"
REFUSED = b"HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\nretry-after: 5\r\ncontent-length: 0\r\n\r\n"


class Http(H11Protocol):
    """HTTP/1.1: one request at a time is read, within a time, from no more than `limit_concurrency` connections."""

    request_seconds = REQUEST_SECONDS
    _warned = -WARNING_SECONDS

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Serve it, or refuse it where there are too many."""
        super().connection_made(transport)
        self.flow = _OneRequest(transport, self.conn)
        self._deadline: asyncio.TimerHandle | None = None
        # Counted with itself, so that uvicorn, which refuses requests from that number on, never comes to that.
        if self.limit_concurrency is not None and len(self.connections) > self.limit_concurrency - 1:
            self._warn_once_in_a_while(self.limit_concurrency - 1)
            transport.write(REFUSED)
            transport.close()
            return
        self._limit_time()

    def data_received(self, data: bytes) -> None:
        """Take what was sent."""
        super().data_received(data)
        self._limit_time()

    def on_response_complete(self) -> None:
        """Go on with the next request, which may be here already."""
        super().on_response_complete()
        if not self.transport.is_closing():
            self.flow.resume_reading()
            self._limit_time()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        super().connection_lost(exc)
        self._limit_time()

    def shutdown(self) -> None:
        """Close it when what is being answered is read, or after a while."""
        super().shutdown()
        self.loop.call_later(END_SECONDS, self.transport.abort)

    def _limit_time(self) -> None:
        """Have the deadline run as long as a request is awaited, other than between two: that is `keep_alive`."""
        open_for_it = self in self.connections and self.timeout_keep_alive_task is None
        if open_for_it and self.conn.their_state in (h11.IDLE, h11.SEND_BODY):
            if self._deadline is None:
                self._deadline = self.loop.call_later(self.request_seconds, self._end_late_request)
        elif self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _end_late_request(self) -> None:
        cycle: Any = self.cycle
        if cycle is None or cycle.response_complete or not cycle.response_started:
            self.transport.write(TIMED_OUT)
        self.transport.close()

    @classmethod
    def _warn_once_in_a_while(cls, most: int) -> None:
        now = time.monotonic()
        if now - Http._warned >= WARNING_SECONDS:
            Http._warned = now
            log.warning("%d connections are open, and no more are allowed: others are refused", most)


class _OneRequest(FlowControl):
    """Reads no further while a request is answered: `receive` would ask for more each time, and pile it up."""

    def __init__(self, transport: asyncio.Transport, conn: h11.Connection) -> None:
        super().__init__(transport)
        self._conn = conn

    def resume_reading(self) -> None:
        if self._conn.their_state is not h11.DONE:
            super().resume_reading()


class WebSockets(WebSocketsSansIOProtocol):
    """WebSockets: who does not read is not read from; each ping would add an answer."""

    def pause_writing(self) -> None:
        """Write no more for now."""
        super().pause_writing()
        if not self.transport.is_closing():
            self.transport.pause_reading()

    def resume_writing(self) -> None:
        """Write on."""
        super().resume_writing()
        if not self.read_paused and not self.transport.is_closing():
            self.transport.resume_reading()

    def shutdown(self) -> None:
        """Say goodbye, and close it when that is read, or after a while."""
        super().shutdown()
        self.loop.call_later(END_SECONDS, self.transport.abort)
