"""Callers that stop reading: they hold up nobody else, and nothing grows without bound for them."""

import asyncio
import base64
import json
import re
import select
import socket
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
import websockets.sync.client
from starlette.types import ASGIApp, Message

from drone_env.server.app import create_app
from drone_env.server.logs import KEPT, LoggedRequest, RequestLog
from drone_env.server.routes.history import FOLLOWERS
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


FOLLOW = {
    "type": "http",
    "method": "GET",
    "path": "/terminal_logs",
    "query_string": b"",
    "headers": [(b"accept", b"text/event-stream")],
}


class Follower:
    """A reader of the live request log; the server waits until `reads` is set."""

    def __init__(self, app: ASGIApp) -> None:
        self.reads, self.stalled, self.status = asyncio.Event(), asyncio.Event(), 0
        self.numbers: list[int] = []
        self.task = asyncio.create_task(app(dict(FOLLOW), self._receive, self._send))

    async def _receive(self) -> Message:
        await asyncio.Event().wait()
        raise AssertionError("nothing comes")

    async def _send(self, message: Message) -> None:
        self.status = message.get("status", self.status)
        self.numbers += map(int, re.findall(rb"^id: (\d+)", message.get("body", b""), re.MULTILINE))
        if self.numbers:
            self.stalled.set()
            await self.reads.wait()

    async def wait_for(self, number: int) -> None:
        while number not in self.numbers:
            await asyncio.sleep(0.01)


def test_followers_of_the_requests_share_what_is_written_and_skip_what_is_not_kept_any_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    app = create_app(Settings(data=tmp_path / "data"))
    log: RequestLog = app.state.shared.requests
    written: list[int] = []
    write = LoggedRequest.model_dump_json
    monkeypatch.setattr(LoggedRequest, "model_dump_json", lambda self: (written.append(self.number), write(self))[1])

    async def follow() -> None:
        log.add("GET", "/first", 200, 0)
        followers = [Follower(app) for _ in range(FOLLOWERS)]
        for follower in followers:
            await follower.stalled.wait()
        refused = Follower(app)
        await refused.task
        assert (refused.status, followers[0].status) == (503, 200)
        for follower in followers[1:]:
            follower.reads.set()
        log.add("GET", "/second", 200, 0)
        await asyncio.gather(*[follower.wait_for(3) for follower in followers[1:]])
        assert written == [1, 2, 3]  # the third is the refusal
        for _ in range(5 * KEPT):
            log.add("GET", "/later", 200, 0)
        followers[0].reads.set()
        await asyncio.gather(*[follower.wait_for(log.count) for follower in followers])
        assert followers[0].numbers == [1, *range(log.count - KEPT + 1, log.count + 1)]
        for follower in followers:
            follower.task.cancel()
        await asyncio.gather(*[follower.task for follower in followers], return_exceptions=True)
        assert log.followers == 0

    asyncio.run(asyncio.wait_for(follow(), 60))
