"""Limits of each connection, on top of uvicorn's protocols.

uvicorn parses all received data at once: any number of headers, chunks, requests and frames, ahead of the responses.
These protocols parse one request or frame at a time, bound its parts, and stop reading from clients that do not read.
They use httptools, because h11 takes longer for a request than flying and storing a step takes.
"""

import asyncio
import logging
import time
from collections import Counter
from typing import Any, cast

import httptools
from uvicorn.protocols.http.flow_control import FlowControl
from uvicorn.protocols.http.httptools_impl import STATUS_LINE, HttpToolsProtocol
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

log = logging.getLogger(__name__)

REQUEST_SECONDS = 30.0
"""Time for a whole request to arrive."""
HEAD_BYTES, HEADERS = 16_384, 100
"""Most bytes of a request outside its body, and most headers; browsers and proxies send about a tenth of that."""
INVALID = 400, "this is not a valid HTTP request"
TOO_LARGE = 431, f"a request has at most {HEADERS} headers and {HEAD_BYTES} bytes outside its body"
END_SECONDS = 4.0
"""Time for clients to read the last responses when the server stops."""
END_OF_HEAD = b"\r\n\r\n"
FRAGMENTS = 100
"""Most frames of a WebSocket message."""
PINGS, PINGS_PER_SECOND = 20, 2
"""Most pings in a burst, and their average rate; clients send one in 20 seconds. A client that has computed for minutes
answers all pings of the server at once, so pongs have no limit.
"""
INVALID_DATA, POLICY_VIOLATION = 1007, 1008
PING = 0x9
LARGEST_FRAME_HEAD = 14


class Http(HttpToolsProtocol):
    """HTTP/1.1: reads one request at a time, with limits of size and time, on `limit_concurrency` connections."""

    request_seconds = REQUEST_SECONDS

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Accept the connection, or refuse it if there are too many."""
        super().connection_made(transport)
        self.flow = _OneRequest(transport, self)
        self._deadline: asyncio.TimerHandle | None = None
        self._unread = b""
        self._in_head = True
        self._head_bytes = self._body_left = 0
        self._refusal = INVALID
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
        self._unread = self._unread + data if self._unread else data
        self._read()

    def on_header(self, name: bytes, value: bytes) -> None:
        """Add a header; trailers are ignored.

        Raises:
            ValueError: if there are too many.
        """
        if self._in_head:
            if len(self.headers) >= HEADERS:
                self._refusal = TOO_LARGE
                raise ValueError  # stops the parser; `_parse` sends the response
            super().on_header(name, value)

    def on_headers_complete(self) -> None:
        """Start the response."""
        self._in_head = False
        self._body_left = next((int(value) for name, value in self.headers if name == b"content-length"), 0)
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        """Add a chunk of a body."""
        self._head_bytes -= len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        """End the request."""
        self._in_head = True
        self._head_bytes = self._body_left = 0
        super().on_message_complete()

    def on_response_complete(self) -> None:
        """Continue with the next request, which may have arrived already."""
        super().on_response_complete()
        if not self.transport.is_closing():
            self._read()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        super().connection_lost(exc)
        self._limit_time()

    def shutdown(self) -> None:
        """Close the connection when the client has read the response, or after `END_SECONDS`."""
        super().shutdown()
        self.loop.call_later(END_SECONDS, self.transport.abort)

    def _make_room(self) -> bool:
        """Close a connection of the address with the most, and return whether there was one.

        It is the one that was unused for longest among those without a request. If there is none, it is any other,
        unless the new connection is from the same address.
        """
        others = [other for other in self.connections if isinstance(other, Http) and other is not self]
        counts = Counter(other.address for other in others)
        most = max(counts, key=counts.__getitem__, default=None)
        closable = [
            other for other in others if other.address == most and not (other.answering and most == self.address)
        ]
        if not closable:
            return False
        closed = min(closable, key=lambda other: (other.answering, other._used_at))
        self.connections.discard(closed)  # the transport reports the loss later
        closed.transport.abort() if closed.answering else closed.transport.close()
        return True

    def _read(self) -> None:
        """Parse up to the end of one request. The end of its response continues with the next."""
        data, start = self._unread, 0
        while start < len(data) and not self.answering:
            # The parser would continue with the next request, so it gets the data up to a possible end of this one.
            if self._body_left:
                end = min(start + self._body_left, len(data))
                self._body_left -= end - start
            else:
                found = data.find(END_OF_HEAD, start)
                end = len(data) if found < 0 else found + len(END_OF_HEAD)
                end = min(end, start + HEAD_BYTES - self._head_bytes)
            if end == start:
                self._end(*TOO_LARGE)
            else:
                self._head_bytes += end - start
                self._parse(data[start:end])
            start = end
            if self.transport.is_closing() or self.transport.get_protocol() is not self:
                start = len(data)
        self._unread = data[start:]
        if self._unread:
            self.flow.pause_reading()
        else:
            self.flow.resume_reading()
        self._limit_time()

    def _parse(self, part: bytes) -> None:
        self._unset_keepalive_if_required()
        try:
            cast(Any, self.parser).feed_data(part)
        except httptools.HttpParserUpgrade:
            if self._should_upgrade():
                self.handle_websocket_upgrade()
            else:
                # Ignore the upgrade. The parser cannot read another request after it.
                self.cycle.keep_alive = False
        except httptools.HttpParserError:
            self._end(*self._refusal)

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


class _OneRequest(FlowControl):
    """Stops reading during a response: uvicorn's `receive` would read on and buffer the data."""

    def __init__(self, transport: asyncio.Transport, protocol: Http) -> None:
        super().__init__(transport)
        self._protocol = protocol

    def resume_reading(self) -> None:
        if not self._protocol.answering:
            super().resume_reading()


class WebSockets(WebSocketsSansIOProtocol):
    """WebSockets: parses one frame at a time, and limits fragments and pings."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Start with an empty buffer."""
        super().connection_made(transport)
        # A client that computes answers no ping, and some tunnels drop pongs. Anything that it sends is a sign of life.
        self.ping_timeout = None
        self._heard_at = self.loop.time()
        self._unread = bytearray()
        self._turn: asyncio.Handle | None = None
        self._pings = self._counted_at = 0.0

    def data_received(self, data: bytes) -> None:
        """Parse the head of the request, which the first call contains completely, or a frame."""
        self._heard_at = self.loop.time()
        if self.handshake_initiated:
            self._unread += data
            if self._turn is None:
                self._take_turn()
            return
        super().data_received(data)
        if not self.handshake_initiated:  # a head with a body or a line over 8 KB gets no response from uvicorn
            self.transport.write(b"".join(self.conn.data_to_send()))
            self.transport.close()

    async def receive(self) -> Any:
        """Return the next message for the application."""
        message = await super().receive()
        if self._unread:
            self._go_on()
        return message

    async def send(self, message: Any) -> None:
        """Send a message of the application.

        Raises:
            ClientDisconnected: if the connection is being closed, for example after a ping without a pong.
        """
        await self.writable.wait()
        if self.close_sent or self.transport.is_closing():
            raise ClientDisconnected
        is_open = self.handshake_complete
        await super().send(message)
        if not is_open:
            self._go_on()

    def send_receive_event_to_app(self) -> None:
        """Queue a message for the application. uvicorn would log a trace for text that is not UTF-8."""
        if self.curr_msg_data_type == "text":
            try:
                b"".join(self.frames).decode()
            except UnicodeDecodeError:
                self._fail(INVALID_DATA, "text must be UTF-8")
                return
        super().send_receive_event_to_app()

    def shutdown(self) -> None:
        """Send a close frame, and close the connection when it is read, or after `END_SECONDS`."""
        if not self.transport.is_closing():
            super().shutdown()
        self.loop.call_later(END_SECONDS, self.transport.abort)

    def send_keepalive_ping(self) -> None:
        """Send a ping and schedule the next, or close the connection if nothing came for `ws_ping_timeout`."""
        limit = self.config.ws_ping_timeout
        if limit is not None and self.loop.time() - self._heard_at > limit:
            self.keepalive_timeout()
        else:
            super().send_keepalive_ping()

    def _take_turn(self) -> None:
        """Parse one frame. Other tasks run before the next."""
        self._turn = None
        size = self._frame_size()
        if self._may_parse() and len(self._unread) >= size:
            frame = bytes(self._unread[:size])
            del self._unread[:size]
            is_control, is_last = frame[0] & 0x08, frame[0] & 0x80
            if frame[0] & 0x0F == PING and not self._count_ping():
                self._fail(POLICY_VIOLATION, f"at most {PINGS_PER_SECOND} pings a second")
            elif not (is_control or is_last) and len(self.frames) >= FRAGMENTS:
                self._fail(POLICY_VIOLATION, f"a message has at most {FRAGMENTS} fragments")
            else:
                super().data_received(frame)
        self._go_on()

    def _go_on(self) -> None:
        """Schedule the next frame, resume reading, or wait until the application receives a message."""
        if (self.read_paused and not self._unread) or self.transport.is_closing():
            return
        may_parse, is_whole = self._may_parse(), len(self._unread) >= self._frame_size()
        if may_parse and is_whole and self._turn is None:
            self._turn = self.loop.call_soon(self._take_turn)
        if may_parse and not is_whole:
            self.transport.resume_reading()
        else:
            self.transport.pause_reading()

    def _may_parse(self) -> bool:
        return self.handshake_complete and not self.read_paused

    def _frame_size(self) -> int:
        """Return the known size of the first frame. If it is too large, the parser needs only its head to refuse it."""
        data = self._unread
        if len(data) < 2:
            return 2
        length = data[1] & 0x7F
        more = {126: 2, 127: 8}.get(length, 0)
        if len(data) < 2 + more:
            return 2 + more
        if more:
            length = int.from_bytes(data[2 : 2 + more], "big")
        size = 2 + more + (4 if data[1] & 0x80 else 0) + length
        return size if length <= self.config.ws_max_size else min(size, LARGEST_FRAME_HEAD)

    def _count_ping(self) -> bool:
        now = self.loop.time()
        left = self._pings - (now - self._counted_at) * PINGS_PER_SECOND
        self._pings, self._counted_at = max(left, 0.0) + 1, now
        return self._pings <= PINGS

    def _fail(self, code: int, reason: str) -> None:
        self.conn.fail(code, reason)
        self.handle_parser_exception()
