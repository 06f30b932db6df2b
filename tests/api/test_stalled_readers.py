"""Callers that stop reading: they hold up nobody else, and nothing grows without bound for them."""

import asyncio
import base64
import json
import select
import socket
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
import websockets.sync.client
from starlette.types import Message

from drone_env.server.app import create_app
from drone_env.server.request_log import KEPT
from drone_env.server.settings import Settings
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


LITTLE = 1 << 20
"""What the kernels of both sides may keep, and some."""


@pytest.mark.parametrize("request_line", ["GET /x", "POST /mcp"])
def test_requests_whose_answers_nobody_reads_are_not_piled_up(server: Server, request_line: str) -> None:
    request = f"{request_line} HTTP/1.1\r\nHost: {urlsplit(server.url).netloc}\r\nContent-Length: 0\r\n\r\n"
    with connected(server) as sock:
        assert pushed(sock, request.encode()) < LITTLE


def test_pings_whose_answers_nobody_reads_are_not_piled_up(server: Server) -> None:
    with open_page(server) as page:
        assert pushed(page, b"\x89\xe4" + bytes(4 + 100)) < LITTLE


def flown_flights(server: Server) -> list[str]:
    """The sessions of a race of two that has ended, which is told in some 100 KB."""
    with websockets.sync.client.connect(server.url.replace("http", "ws") + "/live", open_timeout=60) as page:
        page.send(json.dumps({"type": "start", "task": "easy", "seed": 7, "pilots": ["random"] * 2}))
        page.send(json.dumps({"type": "step"}))
        ended: set[int] = set()
        sessions: list[str] = []
        while len(ended) < 2:
            message = json.loads(page.recv(timeout=60))
            if message["type"] == "flights":
                sessions = [shown["opening"]["session"] for shown in message["flights"]]
            elif message["type"] == "frames":
                page.send(json.dumps({"type": "step"}))
            elif message["type"] == "ended":
                ended.add(message["flight"])
        return sessions


def test_pages_that_do_not_read_hold_up_nobody_and_are_read_from_no_more(server: Server) -> None:
    attach = frame(json.dumps({"type": "attach", "sessions": flown_flights(server)}))
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


def test_a_listener_that_has_not_read_for_long_is_told_what_is_kept_and_no_more(tmp_path: Any) -> None:
    app = create_app(Settings(data=tmp_path / "data"))
    log = app.state.shared.requests
    scope = {
        "type": "http",
        "method": "GET",
        "path": "/terminal_logs",
        "query_string": b"",
        "headers": [(b"accept", b"text/event-stream")],
    }

    async def listen() -> list[int]:
        told: list[int] = []
        stalled, going_on = asyncio.Event(), asyncio.Event()

        async def receive() -> Message:
            await asyncio.Event().wait()
            raise AssertionError("nothing comes")

        async def send(message: Message) -> None:
            line = message.get("body", b"").decode()
            if "data: " in line:
                told.append(json.loads(line.partition("data: ")[2].partition("\n")[0])["number"])
                stalled.set()
                await going_on.wait()

        log.add("GET", "/first", 200, 0)
        listening = asyncio.create_task(app(scope, receive, send))
        await stalled.wait()
        for _ in range(5 * KEPT):
            log.add("GET", "/later", 200, 0)
        going_on.set()
        while not told or told[-1] < 1 + 5 * KEPT:
            await asyncio.sleep(0.01)
        listening.cancel()
        await asyncio.gather(listening, return_exceptions=True)
        return told

    told = asyncio.run(asyncio.wait_for(listen(), 60))
    assert told == [1, *range(2 + 4 * KEPT, 2 + 5 * KEPT)]
