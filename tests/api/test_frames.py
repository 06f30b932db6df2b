"""Limits of WebSockets: their frames, and clients that never answer."""

import logging
import re
import threading

import pytest
from starlette.types import Receive, Scope, Send
from uvicorn.protocols.utils import ClientDisconnected
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from drone_env.server import protocols
from drone_env.server.protocols import WebSockets
from tests.api.raw import MORE, PING, TEXT, everything, open_socket, running
from tests.tools import PATIENCE


async def echo(scope: Scope, receive: Receive, send: Send) -> None:
    """Send each message back."""
    await send({"type": "websocket.accept"})
    await receive()
    while (message := await receive())["type"] == "websocket.receive":
        await send({"type": "websocket.send", "text": message["text"]})


@pytest.mark.parametrize(
    ("frames", "code"),
    [
        (PING * 2 * protocols.PINGS, 1008),
        (TEXT + MORE * protocols.FRAGMENTS, 1008),
        (b"\x81\x81" + bytes(4) + b"\xff", 1007),
        (b"\x81\xff" + bytes(4) + b"\xff" * 8, 1009),
    ],
    ids=["pings", "fragments", "not UTF-8", "too large"],
)
def test_a_socket_that_is_abused_is_closed_without_a_line_in_the_log(
    frames: bytes, code: int, caplog: pytest.LogCaptureFixture
) -> None:
    with running(echo) as connect:
        sock = open_socket(connect())
        sock.sendall(frames)
        sent = b""
        while not re.search(rb"\x88.\x03" + bytes([code - 0x300]), sent):
            sent += (piece := sock.recv(65_536))
            assert piece, sent
    assert not caplog.messages


def test_a_socket_takes_one_frame_in_turn_and_messages_arrive_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    parsed: list[bytes] = []
    parse = WebSocketsSansIOProtocol.data_received
    monkeypatch.setattr(
        WebSocketsSansIOProtocol, "data_received", lambda self, data: (parsed.append(data), parse(self, data))
    )
    large = b"\x81\xfe\x03\xe8" + bytes(4) + b"y" * 1000
    frames = [PING, TEXT, PING, *[MORE] * 20, b"\x80" + MORE[1:], large, b"\x81" + TEXT[1:]] * 4
    expected = ([b"x" * 22, b"y" * 1000, b"x"]) * 4
    data = b"".join(frames)
    with running(echo) as connect:
        for piece in (1, 7, len(data)):
            sock = open_socket(connect())
            parsed.clear()
            for start in range(0, len(data), piece):
                sock.sendall(data[start : start + piece])
            told = b""
            while told.count(b"x") + told.count(b"y") < sum(map(len, expected)):
                told += sock.recv(65_536)
            assert re.findall(rb"[xy]+", told) == expected
            assert parsed == frames


def test_a_socket_that_answers_no_ping_stays_open_while_it_sends() -> None:
    with running(echo, ws_ping_interval=0.02, ws_ping_timeout=0.2) as connect:
        sock = open_socket(connect())
        for _ in range(20):  # twice the time that ends a silent one
            sock.sendall(b"\x81" + TEXT[1:])
            told = b""
            while b"\x89\x04" not in told or b"\x81\x01x" not in told:
                told += sock.recv(64) or pytest.fail("closed")


def test_pongs_that_a_client_owes_may_come_at_once() -> None:
    with running(echo) as connect:
        sock = open_socket(connect())
        sock.sendall((b"\x8a" + PING[1:]) * 5 * protocols.PINGS + b"\x81" + TEXT[1:])
        assert sock.recv(3) == b"\x81\x01x"


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
