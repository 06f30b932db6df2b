"""Limits of connections: number, time, size; the listening socket."""

import asyncio
import re
import socket
import sys
from contextlib import ExitStack, suppress
from http.client import HTTPResponse

import pytest
from starlette.requests import ClientDisconnect, Request
from starlette.types import Receive, Scope, Send

from drone_env.server import protocols
from drone_env.server.process import OTHER_FILES, most_connections
from drone_env.server.protocols import Http
from tests.api.raw import WHOLE, answer, everything, running
from tests.tools import eventually, limited


def status_of(sock: socket.socket) -> int:
    """Read a response, which may come in pieces, and return its status."""
    response = HTTPResponse(sock)
    response.begin()
    if response.status == 200:  # other responses end the connection
        response.read()
    return response.status


def asked(sock: socket.socket) -> int:
    """Send a request, and return the status of the response."""
    sock.sendall(WHOLE)
    return status_of(sock)


class Hurried(Http):
    request_seconds = 2.0


def test_half_requests_are_ended_and_whole_ones_have_time_to_be_answered() -> None:
    release = asyncio.Event()
    loops: list[asyncio.AbstractEventLoop] = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] == "/slow":
            loops.append(asyncio.get_running_loop())
            await release.wait()
        elif scope["method"] == "POST" and b"".join([part async for part in Request(scope, receive).stream()]) == b"":
            return
        await answer(scope, receive, send)

    with running(app, http=Hurried) as connect:
        whole, kept = connect(), connect()
        whole.sendall(WHOLE.replace(b"/", b"/slow", 1))
        assert asked(kept) == 200
        halves = [b"", b"GE", WHOLE[:-2], b"POST / HTTP/1.1\r\nHost: h\r\nContent-Length: 9\r\n\r\nhal"]
        late = [connect() for _ in halves]
        for sock, half in zip(late, halves, strict=True):
            sock.sendall(half)
        again = connect()
        assert asked(again) == 200
        again.sendall(WHOLE[:-2])
        try:
            for sock in (*late, again):
                assert everything(sock).startswith(b"HTTP/1.1 408 ")
        finally:
            # The server stops after this response.
            loops[0].call_soon_threadsafe(release.set)
        assert status_of(whole) == 200
        assert asked(kept) == 200


POSTED = b"POST / HTTP/1.1\r\nHost: h\r\n"
CHUNKED = POSTED + b"Transfer-Encoding: chunked\r\n\r\n"
IN_TURN = [
    (WHOLE, b""),
    (POSTED + b"Content-Length: 8\r\n\r\na\r\n\r\nb\r\n", b"a\r\n\r\nb\r\n"),
    (CHUNKED + b"4\r\n\r\n\r\n\r\n2;x=y\r\nhi\r\n0\r\n\r\n", b"\r\n\r\nhi"),
    (CHUNKED + b"3\r\nend\r\n000\r\n\r\n", b"end"),
]
"""Requests and their bodies."""


@pytest.mark.parametrize("piece", [1, 7, 1 << 20])
def test_requests_in_one_piece_are_answered_one_after_another(piece: int) -> None:
    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        told = b"%d:" % len(scope["headers"]) + await Request(scope, receive).body()
        length = str(len(told)).encode()
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", length)]})
        await send({"type": "http.response.body", "body": told})

    requests = IN_TURN * (20 if piece > 7 else 1)
    last = WHOLE.replace(b"Host", b"Connection: close\r\nHost")
    expected = [b"%d:" % (request.partition(b"\r\n\r\n")[0].count(b"\r\n")) + body for request, body in requests]
    with running(app) as connect:
        sock = connect()
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        data = b"".join(request for request, _ in requests) + last
        for start in range(0, len(data), piece):
            sock.sendall(data[start : start + piece])
        answers = everything(sock).split(b"HTTP/1.1 200 OK\r\n")[1:]
    assert [answer.partition(b"\r\n\r\n")[2] for answer in answers] == [*expected, b"2:"]


BOUNDED = {
    "an endless header": (WHOLE[:-2] + b"a: " + b"b" * protocols.HEAD_BYTES, 431),
    "an endless path": (b"GET /" + b"x" * protocols.HEAD_BYTES, 431),
    "an endless trailer": (CHUNKED + b"0\r\nLong: " + b"x" * protocols.HEAD_BYTES, 431),
    "an endless extension": (CHUNKED + b"1;x=" + b"x" * protocols.HEAD_BYTES, 431),
}
"""Requests and the status of the response."""


@pytest.mark.parametrize("kind", BOUNDED)
def test_the_parts_of_a_request_are_bounded(kind: str) -> None:
    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        with suppress(ClientDisconnect):
            await Request(scope, receive).body()
            await answer(scope, receive, send)

    request, status = BOUNDED[kind]
    with running(app) as connect:
        sock = connect()
        sock.sendall(request)
        assert status_of(sock) == status


ASKED, CLOSING = b"GET / HTTP/1.1\r\n", b"Connection: close\r\n"
SIZED = POSTED + b"Content-Length: 2\r\n"
SHAPES = {
    "without a body": (b"HEAD / HTTP/1.1\r\nHost: h\r\n\r\n", "200 kept", "HEAD / "),
    "a read with a body": (ASKED + b"Host: h\r\nContent-Length: 2\r\n\r\nhi", "200 kept", "GET / hi"),
    "chunked": (CHUNKED + b"2;x=y\r\nhi\r\n0\r\n\r\n", "200 kept", "POST / hi"),
    "asks before its body": (SIZED + b"Expect: 100-continue\r\n\r\nhi", "100 200 kept", "POST / hi"),
    "the last": (ASKED + b"Host: h\r\n" + CLOSING + b"\r\n", "200 closed", "GET / "),
    "of HTTP/1.0, of no host": (b"GET / HTTP/1.0\r\n\r\n", "200 closed", "GET / "),
    "two lengths": (SIZED + b"Content-Length: 3\r\n\r\nhi!", "400 closed", ""),
    "length and chunks": (SIZED + b"Transfer-Encoding: chunked\r\n\r\n2\r\nhi\r\n0\r\n\r\n", "400 closed", ""),
}
"""Requests; the responses and the state of the connection; the request in the application."""


@pytest.mark.parametrize("shape", SHAPES)
def test_requests_of_any_shape_are_understood_or_refused(shape: str) -> None:
    request, outcome, told = SHAPES[shape]
    seen: list[str] = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        body = (await Request(scope, receive).body()).decode()
        seen.append(f"{scope['method']} {scope['path']} {body}")
        await answer(scope, receive, send)

    with running(app) as connect:
        sock = connect()
        # The next request shows whether the server read the first one exactly to its end.
        sock.sendall(request + b"PUT /next HTTP/1.1\r\nHost: h\r\n" + CLOSING + b"\r\n")
        *statuses, last = re.findall(rb"HTTP/1\.1 (\d+)", answered := everything(sock))
    kept = seen[-1:] == ["PUT /next "]
    assert f"{b' '.join(statuses if kept else [*statuses, last]).decode()} {'kept' if kept else 'closed'}" == outcome
    assert seen[: -1 if kept else None] == ([told] if told else [])
    assert answered.count(b"ok") == outcome.count("200") * (shape != "without a body") + kept


def closed(sock: socket.socket) -> bool:
    """Whether the server has closed a connection."""
    sock.setblocking(False)
    with suppress(BlockingIOError):
        everything(sock)
        return True
    return False


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has the whole of 127.0.0.0/8")
def test_a_full_server_closes_what_the_greediest_address_uses_least(caplog: pytest.LogCaptureFixture) -> None:
    release = asyncio.Event()
    loops: list[asyncio.AbstractEventLoop] = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["path"] == "/slow":
            loops.append(asyncio.get_running_loop())
            await release.wait()
        await answer(scope, receive, send)

    def connect_from(address: str) -> socket.socket:
        return opened.enter_context(socket.create_connection(greedy[0].getpeername(), 60, (address, 0)))

    with ExitStack() as opened, running(app, connections=5) as connect:
        greedy = [connect()]
        other = connect_from("127.0.0.2")
        greedy += [connect() for _ in range(3)]
        for sock in (greedy[2], other, greedy[0], greedy[1], greedy[3]):
            assert asked(sock) == 200
            if sock is greedy[2]:
                sock.sendall(WHOLE[:-2])
        # Both newcomers are served, also the one of the same address; the one with half a request goes first.
        newcomers = [connect(), connect_from("127.0.0.3")]
        for sock in newcomers:
            assert asked(sock) == 200
        assert [closed(sock) for sock in greedy] == [True, False, True, False]
        assert not closed(other)
        # Those that are being answered are never closed.
        working = [greedy[1], greedy[3], other, *newcomers]
        for number, sock in enumerate(working, 1):
            sock.settimeout(60)
            sock.sendall(WHOLE.replace(b"/", b"/slow", 1))
            eventually(lambda number=number: len(loops) == number)
        assert everything(connect()).startswith(b"HTTP/1.1 503 ")
        loops[0].call_soon_threadsafe(release.set)
        for sock in working:
            assert status_of(sock) == 200
    assert set(caplog.messages) == {"5 connections are open, which is the limit: unused ones are closed"}


@pytest.mark.skipif(sys.platform == "win32", reason="there is no limit of open files")
def test_connections_leave_room_for_other_files() -> None:
    import resource

    with limited(resource.RLIMIT_NOFILE, 1000):
        assert [most_connections(wanted) for wanted in (500, 5000)] == [500, 1000 - OTHER_FILES]
