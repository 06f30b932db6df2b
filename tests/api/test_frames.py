"""Limits of WebSockets: their frames, and clients that never answer."""

import logging
import re
import threading

import pytest
from starlette.types import Receive, Scope, Send
from uvicorn.protocols.utils import ClientDisconnected

from drone_env.server.protocols import WebSockets
from tests.api.raw import MORE, PING, TEXT, everything, masked, open_socket, running, taken_of
from tests.tools import PATIENCE


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    """Send each message back."""
    await send({"type": "websocket.accept"})
    await receive()
    while (message := await receive())["type"] == "websocket.receive":
        await send({"type": "websocket.send", "text": message["text"]})


def test_a_frame_that_is_too_large_closes_the_socket_without_a_line_in_the_log(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with running(echo) as connect:
        sock = open_socket(connect())
        sock.sendall(b"\x81\xff" + bytes(4) + b"\xff" * 8)
        assert b"\x03\xf1" in everything(sock)  # 1009
    assert not caplog.messages


@pytest.mark.parametrize("piece", [1, 7, 1 << 20])
def test_messages_arrive_whole(piece: int) -> None:
    large = b"\x81\xfe\x03\xe8" + bytes(4) + b"y" * 1000
    frames = [PING, TEXT, PING, *[MORE] * 20, b"\x80" + MORE[1:], large, b"\x81" + TEXT[1:]] * 4
    expected = [b"x" * 22, b"y" * 1000, b"x"] * 4
    data = b"".join(frames)
    with running(echo) as connect:
        sock = open_socket(connect())
        for start in range(0, len(data), piece):
            sock.sendall(data[start : start + piece])
        told = b""
        while told.count(b"x") + told.count(b"y") < sum(map(len, expected)):
            told += sock.recv(65_536)
        assert re.findall(rb"[xy]+", told) == expected


def test_nothing_more_is_read_from_a_client_that_does_not_read() -> None:
    with running(echo) as connect:
        assert taken_of(open_socket(connect()), masked(b"x" * 100, 9) * 100, most=4 << 20) < 2 << 20


def test_a_socket_that_sends_nothing_not_even_a_pong_is_closed_and_the_application_stops(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    ended: list[BaseException] = []
    closed = threading.Event()
    close = WebSockets.keepalive_timeout
    monkeypatch.setattr(WebSockets, "keepalive_timeout", lambda self: (close(self), closed.set()))

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        await send({"type": "websocket.accept"})
        try:
            while True:
                await send({"type": "websocket.send", "text": "x" * 10_000})
        except OSError as error:
            ended.append(error)

    with running(app, ws_ping_interval=0.1, ws_ping_timeout=0.1) as connect:
        sock = open_socket(connect())
        assert closed.wait(PATIENCE)
        # This wakes the application, which waits to send more.
        assert everything(sock).endswith(b"keepalive ping timeout")
    assert [type(error) for error in ended] == [ClientDisconnected]
    assert not [record for record in caplog.records if record.levelno >= logging.ERROR]
