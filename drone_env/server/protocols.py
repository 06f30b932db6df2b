"""How a process serves its connections: uvicorn's protocols, with an end for callers that never finish.

Requests are parsed by httptools: h11 takes longer for one than flying and storing a step does. But it hands on all that
can be parsed: one caller that sends requests and reads no answers would fill the memory with them, and a header line
may have any length. So it is given one request at a time, and a limited number of bytes before a body.
"""

import asyncio
import logging
import time
from typing import Any, cast

from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

log = logging.getLogger(__name__)

REQUEST_SECONDS = 30.0
"""A request is here as a whole after so long, and a new connection has sent one."""
HEAD_BYTES = 65_536
"""The most of a request that is no body: its line and headers, or what stands between and after pieces of a body."""
END_SECONDS = 4.0
"""What callers have not read so long after the server was asked to end is thrown away."""
WARNING_SECONDS = 60.0
END_OF_HEAD = b"\r\n\r\n"
TIMED_OUT = b"HTTP/1.1 408 Request Timeout\r\nconnection: close\r\ncontent-length: 0\r\n\r\n"
REFUSED = b"HTTP/1.1 503 Service Unavailable\r\nconnection: close\r\nretry-after: 5\r\ncontent-length: 0\r\n\r\n"


class Http(HttpToolsProtocol):
    """HTTP/1.1: one request at a time is read, within a time, from no more than `limit_concurrency` connections."""

    request_seconds = REQUEST_SECONDS
    _warned = -WARNING_SECONDS

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Serve it, or refuse it where there are too many."""
        super().connection_made(transport)
        self.flow = _OneRequest(transport, self)
        self._deadline: asyncio.TimerHandle | None = None
        self._unread = b""
        self._in_head = True
        self._head_bytes = 0
        self._body_left = 0
        # Counted with itself, so that uvicorn, which refuses requests from that number on, never gets there.
        if self.limit_concurrency is not None and len(self.connections) > self.limit_concurrency - 1:
            self._warn_once_in_a_while(self.limit_concurrency - 1)
            transport.write(REFUSED)
            transport.close()
            return
        self._limit_time()

    @property
    def answering(self) -> bool:
        """Whether a request is here as a whole and has not been answered."""
        cycle: Any = self.cycle
        return bool(self.pipeline) or (cycle is not None and not cycle.more_body and not cycle.response_complete)

    def data_received(self, data: bytes) -> None:
        """Take what was sent."""
        self._unread = self._unread + data if self._unread else data
        self._read()

    def on_headers_complete(self) -> None:
        """Begin to answer.

        Raises:
            ValueError: if it is not said once which host is meant, the head is too long, or the body is in a form that
                nobody here reads; the parser has that answered with 400.
        """
        if len(self.url) + sum([len(name) + len(value) for name, value in self.headers]) > HEAD_BYTES:
            raise ValueError("a request has a head of bounded length")
        names, parser = [name for name, _ in self.headers], cast(Any, self.parser)
        if names.count(b"host") not in ((0, 1) if parser.get_http_version() == "1.0" else (1,)):
            raise ValueError("a request names one host")
        if [value.lower() for name, value in self.headers if name == b"transfer-encoding"] not in ([], [b"chunked"]):
            raise ValueError("a body comes as it is or chunked")
        self._in_head = False
        self._head_bytes = 0
        self._body_left = int(self.headers[names.index(b"content-length")][1]) if b"content-length" in names else 0
        super().on_headers_complete()

    def on_header(self, name: bytes, value: bytes) -> None:
        """Take a header; what stands after a body is nobody's to read."""
        if self._in_head:
            super().on_header(name, value)

    def on_body(self, body: bytes) -> None:
        """Take a piece of a body."""
        self._head_bytes = 0
        super().on_body(body)

    def on_message_complete(self) -> None:
        """Have the whole request."""
        self._in_head = True
        self._head_bytes = self._body_left = 0
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Go on with the next request, which may be here already."""
        super().on_response_complete()
        if not self.transport.is_closing():
            self._read()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        super().connection_lost(exc)
        self._limit_time()

    def shutdown(self) -> None:
        """Close it when what is being answered is read, or after a while."""
        super().shutdown()
        self.loop.call_later(END_SECONDS, self.transport.abort)

    def _read(self) -> None:
        """Parse what is here, up to the end of a request; the rest when that is answered."""
        data, start = self._unread, 0
        while start < len(data) and not self.answering:
            # The parser goes on to the next request by itself: it is given what one may end with, and no more.
            if self._body_left:
                end = start + self._body_left
                self._body_left = max(0, end - len(data))
            else:
                found = data.find(END_OF_HEAD, start)
                end = len(data) if found < 0 else found + len(END_OF_HEAD)
            part = data[start:end]
            start = end
            self._head_bytes += len(part)
            super().data_received(part)
            if self._head_bytes > HEAD_BYTES and not self.transport.is_closing():
                self.send_400_response(f"A request has at most {HEAD_BYTES} bytes beside its body.")
            if self.transport.is_closing() or self.transport.get_protocol() is not self:
                start = len(data)
        self._unread = data[start:]
        if self._unread:
            self.flow.pause_reading()
        else:
            self.flow.resume_reading()
        self._limit_time()

    def _limit_time(self) -> None:
        """Have the deadline run as long as a request is awaited, other than between two: that is `keep_alive`."""
        if self in self.connections and self.timeout_keep_alive_task is None and not self.answering:
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

    def __init__(self, transport: asyncio.Transport, protocol: Http) -> None:
        super().__init__(transport)
        self._protocol = protocol

    def resume_reading(self) -> None:
        if not self._protocol.answering:
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
