"""Raw connections to a server in this process or another."""

import select
import socket
import threading
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager
from typing import Any

import uvicorn
from starlette.types import ASGIApp, Receive, Scope, Send

from drone_env.server.protocols import Http, WebSockets
from tests.tools import PATIENCE

PING, TEXT, MORE = b"\x89\x80" + bytes(4), b"\x01\x81" + bytes(4) + b"x", b"\x00\x81" + bytes(4) + b"x"
"""Masked frames: a ping without payload, and one-byte fragments of a text: the first, and another."""
WHOLE = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"
UPGRADE = b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
KEY = b"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"


async def answer(scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "http":
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"2")]})
        await send({"type": "http.response.body", "body": b"ok"})


@contextmanager
def running(
    app: ASGIApp, connections: int = 100, http: type[Http] = Http, **more: Any
) -> Generator[Callable[[], socket.socket]]:
    """Run a server in a thread; yields a function that opens a connection to it."""
    listening = socket.create_server(("127.0.0.1", 0))
    for size in (socket.SO_SNDBUF, socket.SO_RCVBUF):
        listening.setsockopt(socket.SOL_SOCKET, size, 65_536)  # on Linux, connections inherit it
    config = uvicorn.Config(
        app, http=http, ws=WebSockets, lifespan="off", log_config=None, limit_concurrency=connections + 1, **more
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, args=([listening],))
    thread.start()
    with ExitStack() as opened:

        def connect() -> socket.socket:
            return opened.enter_context(connected(listening.getsockname()))

        try:
            yield connect
        finally:
            opened.close()
            server.should_exit = True
            thread.join(PATIENCE)
    assert not thread.is_alive()


def connected(address: tuple[str, int]) -> socket.socket:
    """A connection with small buffers, so that little data is in flight."""
    sock = socket.socket()
    for size in (socket.SO_SNDBUF, socket.SO_RCVBUF):
        sock.setsockopt(socket.SOL_SOCKET, size, 16_384)
    sock.settimeout(PATIENCE)
    sock.connect(address)
    return sock


def open_socket(sock: socket.socket, path: bytes = b"/") -> socket.socket:
    """Open a WebSocket on a connection."""
    sock.sendall(WHOLE.replace(b"/", path, 1)[:-2] + UPGRADE + KEY + b"\r\n")
    head = b""
    while not head.endswith(b"\r\n\r\n"):
        head += sock.recv(1)
    assert head.startswith(b"HTTP/1.1 101 ")
    return sock


def masked(payload: bytes, opcode: int = 1) -> bytes:
    """A frame of at most 125 bytes as clients of a WebSocket send it, masked with zeros."""
    return bytes([0x80 | opcode, 0x80 | len(payload)]) + bytes(4) + payload


def everything(sock: socket.socket) -> bytes:
    """Read until the server closes the connection."""
    return b"".join(iter(lambda: sock.recv(65_536), b""))


def taken_of(sock: socket.socket, data: bytes, most: int) -> int:
    """Return how many bytes the server accepts of the same data again and again, until it accepts none for a second."""
    sock.setblocking(False)
    many, taken = data * (1 + (1 << 20) // len(data)), 0
    while taken < most and select.select([], [sock], [], 1)[1]:
        taken += sock.send(many[taken % len(data) :])
    return taken
