"""Clients that stop reading block no other client, and use bounded memory."""

import asyncio
import base64
import json
import re
import select
import socket
from urllib.parse import urlsplit

import httpx
import pytest
import websockets.sync.client
from starlette.testclient import TestClient

from drone_env.server.logs import KEPT, RequestLog
from drone_env.server.routes.history import FOLLOWERS
from tests.api.serving import Server

MOST = 64 << 20
"""Bytes that nobody who is answered would be able to leave with the server: kernels keep some MB."""


def connected(server: Server) -> socket.socket:
    address = urlsplit(server.url)
    sock = socket.socket()
    # What is on its way to the one who does not read is then little.
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    sock.settimeout(60)
    sock.connect((address.hostname, address.port))
    return sock


def frame(text: str) -> bytes:
    """A WebSocket frame of a client, masked with zeros."""
    data = text.encode()
    return b"\x81\xff" + len(data).to_bytes(8, "big") + bytes(4) + data


def open_page(server: Server) -> socket.socket:
    """A page on `/live` whose frames nobody reads."""
    sock = connected(server)
    key = base64.b64encode(bytes(16)).decode()
    sock.sendall(
        f"GET /live HTTP/1.1\r\nHost: {urlsplit(server.url).netloc}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    assert sock.recv(12) == b"HTTP/1.1 101"
    return sock


def pushed(sock: socket.socket, data: bytes) -> int:
    """How many bytes the server takes of the same thing again and again before it takes no more."""
    sock.setblocking(False)
    many = data * (1 + (1 << 20) // len(data))
    taken = 0
    # A busy machine may be slow to take more: then the others below are served while it is.
    while taken < MOST and select.select([], [sock], [], 1)[1]:
        taken += sock.send(many[taken % len(data) :])
    return taken


def test_pages_that_do_not_read_hold_up_nobody_and_are_read_from_no_more(server: Server) -> None:
    attach = frame(json.dumps({"type": "attach", "sessions": ["nobody"]}))
    host = urlsplit(server.url).netloc
    with open_page(server) as page, connected(server) as listener:
        listener.sendall(f"GET /terminal_logs HTTP/1.1\r\nHost: {host}\r\nAccept: text/event-stream\r\n\r\n".encode())
        page.sendall(frame(json.dumps({"type": "subscribe", "topics": ["requests", "episodes"]})))
        assert pushed(page, attach) < MOST
        with httpx.Client(base_url=server.url, timeout=60) as http:
            for _ in range(2 * KEPT):
                assert http.get("/nowhere/" + "x" * 190).status_code == 404
        with websockets.sync.client.connect(server.url.replace("http", "ws") + "/live", open_timeout=60) as other:
            other.send(json.dumps({"type": "start", "task": "easy", "seed": 7, "pilots": ["greedy"]}))
            while json.loads(other.recv(timeout=60))["type"] != "flights":
                pass
    assert server.client.get("/health", timeout=60).status_code == 200
    assert "Traceback" not in server.log.read_text()


@pytest.mark.feature("H9")
def test_the_request_log_is_streamed(server: Server) -> None:
    with (
        httpx.Client(base_url=server.url, timeout=60) as http,
        http.stream("GET", "/terminal_logs", headers={"Accept": "text/event-stream"}) as live,
    ):
        assert live.headers["Content-Type"].startswith("text/event-stream")
        entries = (json.loads(line[6:]) for line in live.iter_lines() if line.startswith("data: "))
        http.get("/health?while=listening")
        before = http.get("/terminal_logs").json()["requests"][-1]["number"]
        http.get("/tasks?while=listening")
        later = next(one for one in entries if one["number"] > before and one["path"] == "/tasks")
        assert (later["method"], later["status"]) == ("GET", 200)


def test_followers_of_the_requests_skip_what_is_not_kept_any_more() -> None:
    log = RequestLog()

    def numbers(events: bytes) -> list[int]:
        return [int(number) for number in re.findall(rb"^id: (\d+)", events, re.MULTILINE)]

    async def follow() -> None:
        log.add("GET", "/first", 200, 0)
        reader = log.follow()
        assert numbers(await anext(reader)) == [1]
        for _ in range(5 * KEPT):
            log.add("GET", "/later", 200, 0)
        assert numbers(await anext(reader)) == [*range(log.count - KEPT + 1, log.count + 1)]

    asyncio.run(asyncio.wait_for(follow(), 60))


def test_there_is_room_for_so_many_followers(client: TestClient) -> None:
    client.app.state.shared.requests.followers = FOLLOWERS  # pyright: ignore
    assert client.get("/terminal_logs", headers={"Accept": "text/event-stream"}).status_code == 503
