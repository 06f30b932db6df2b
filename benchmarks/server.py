"""Measure the cost of a step over WebSocket and HTTP, and of OpenEnv's echo environment in the same run.

    python benchmarks/server.py [--task hard] [--seconds 5] [--rounds 3] [--sessions 1 8 64 256]
                                [--by WebSocket HTTP] [--other CHECKOUT]

The echo environment is the one that `openenv init` writes, served by OpenEnv's own server. Each server has one worker,
each session one persistent connection and one request at a time. Over HTTP, our server stores each step before it
responds; OpenEnv's server makes a new environment for each step.

`--other` names a second checkout of this project, such as one by `git worktree add`, and times its server in the same
rounds. Rounds alternate between the servers; the table shows medians. Other load on the machine hardly changes the CPU
time. The load comes from this process, which speaks both protocols itself: libraries would take more time than the
servers.
"""

import argparse
import asyncio
import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator, Iterable, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from tests.tools import eventually, is_taken  # noqa: E402

PORTS = {"drone-env": 18_431, "echo": 18_432, "other": 18_433}
WAYS = ("WebSocket", "HTTP")
MOVES = ("UP", "LEFT", "DOWN", "RIGHT")
NEW = {"X-Session-Id": "new"}
ECHO_SERVER = """
import sys
sys.path.insert(0, {folder!r})
from openenv.core.env_server import create_fastapi_app
from echo.models import EchoAction, EchoObservation
from echo.server.echo_environment import EchoEnvironment
import uvicorn
app = create_fastapi_app(EchoEnvironment, EchoAction, EchoObservation, max_concurrent_envs=1024)
uvicorn.run(app, port={port}, access_log=False, log_level="warning")
"""


class Figures(NamedTuple):
    """The result of one round."""

    steps_per_second: float
    p50_ms: float
    p99_ms: float
    cpu_us: float
    """CPU time of the server for a step."""
    proxy_us: float
    """CPU time of the proxy for a step."""
    received: float
    """Bytes of the response to a step."""


def frame(message: dict[str, Any]) -> bytes:
    """A text frame as clients send it, masked with zeros."""
    payload = json.dumps(message).encode()
    length = bytes([0x80 | len(payload)]) if len(payload) < 126 else bytes([0xFE]) + len(payload).to_bytes(2, "big")
    return b"\x81" + length + bytes(4) + payload


class Connection:
    """A persistent connection to a server, which counts the bytes of responses."""

    def __init__(self, port: int) -> None:
        self.port = port
        self.received = 0

    async def open(self) -> None:
        """Connect."""
        self.reader, self.writer = await asyncio.open_connection("127.0.0.1", self.port, limit=1 << 20)

    async def close(self) -> None:
        """End the connection."""
        self.writer.close()
        await self.writer.wait_closed()

    async def ask(self, message: bytes) -> bytes:
        """Send an encoded message and return the response."""
        self.writer.write(message)
        return await self.answer()

    async def answer(self) -> bytes:
        """The next response."""
        raise NotImplementedError


class Socket(Connection):
    """A WebSocket to `/ws`."""

    async def open(self) -> None:
        """Connect."""
        await super().open()
        self.writer.write(
            f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{self.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        answer = await self.reader.readuntil(b"\r\n\r\n")
        if b" 101 " not in answer:
            raise ConnectionError(answer.decode())

    async def answer(self) -> bytes:
        """The payload of the next text frame. Pings get a pong."""
        while True:
            head = await self.reader.readexactly(2)
            length = head[1] & 0x7F
            if length >= 126:
                length = int.from_bytes(await self.reader.readexactly(2 if length == 126 else 8), "big")
            payload = await self.reader.readexactly(length)
            if head[0] == 0x81:
                self.received += len(payload) + 4
                return payload
            if head[0] == 0x88:
                raise ConnectionError(f"the server closed: {payload!r}")
            self.writer.write(bytes([0x8A, 0x80 | len(payload)]) + bytes(4) + payload)


class Http(Connection):
    """HTTP, one request after another."""

    def request(self, path: str, body: dict[str, Any], headers: dict[str, str]) -> bytes:
        """An encoded request."""
        content = json.dumps(body).encode()
        lines = [f"POST {path} HTTP/1.1", f"Host: 127.0.0.1:{self.port}", "Content-Type: application/json"]
        lines += [f"{name}: {value}" for name, value in headers.items()]
        return "\r\n".join([*lines, f"Content-Length: {len(content)}", "", ""]).encode() + content

    async def answer(self) -> bytes:
        """The body of the next response."""
        head = await self.reader.readuntil(b"\r\n\r\n")
        length = next(int(line[15:]) for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:"))
        answer = await self.reader.readexactly(length)
        if b" 200 " not in head[:16]:
            raise ConnectionError(answer.decode())
        self.received += len(head) + length
        return answer


class Session(NamedTuple):
    """An open session: its connection and its encoded requests."""

    connection: Connection
    reset: bytes
    steps: list[bytes]


async def open_session(port: int, way: str, task: str, echo: bool = False) -> Session:
    """A session with a new episode, over its own connection."""
    begin = {} if echo else {"task_name": task}
    actions = [{"message": "RIGHT"}] if echo else [{"direction": move} for move in MOVES]
    if way == "WebSocket":
        socket = Socket(port)
        await socket.open()
        steps = [frame({"type": "step", "data": action}) for action in actions]
        session = Session(socket, frame({"type": "reset", "data": begin}), steps)
        await socket.ask(session.reset)
        return session
    http = Http(port)
    await http.open()
    answer = json.loads(await http.ask(http.request("/reset", begin, {} if echo else NEW)))
    named = {} if echo else {"X-Session-Id": answer["session_id"]}
    bodies = [{"action": action} if echo else action for action in actions]
    return Session(http, http.request("/reset", begin, named), [http.request("/step", body, named) for body in bodies])


async def fly(session: Session, until: float, latencies: list[float]) -> None:
    """Step until the time is over; after each end of an episode, reset."""
    clock, number = time.perf_counter, 0
    while (sent := clock()) < until:
        answer = await session.connection.ask(session.steps[number % len(session.steps)])
        latencies.append(clock() - sent)
        number += 1
        if b'"done":' not in answer:
            raise ConnectionError(answer[:200].decode())
        if b'"done":true' in answer:
            await session.connection.ask(session.reset)


def cpu_seconds(processes: Iterable[int]) -> float:
    """Total CPU time of processes (Linux)."""
    stats = [Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2] for process in processes]
    return sum(int(ticks) for stat in stats for ticks in stat.split()[11:13]) / os.sysconf("SC_CLK_TCK")


async def time_sessions(
    sessions: Sequence[Session], server: Sequence[int], seconds: float, proxy: Sequence[int] = ()
) -> Figures:
    """Step sessions as fast as the server responds, and close them. `server` and `proxy` are process ids."""
    latencies: list[float] = []
    before = sum(session.connection.received for session in sessions)
    cpu, proxy_cpu, started = cpu_seconds(server), cpu_seconds(proxy), time.perf_counter()
    await asyncio.gather(*[fly(session, started + seconds, latencies) for session in sessions])
    elapsed = time.perf_counter() - started
    cpu, proxy_cpu = cpu_seconds(server) - cpu, cpu_seconds(proxy) - proxy_cpu
    received = sum(session.connection.received for session in sessions) - before
    for session in sessions:
        await session.connection.close()
    steps, ordered = len(latencies), sorted(latencies)
    p50, p99 = (ordered[int(share * (steps - 1))] * 1000 for share in (0.5, 0.99))
    return Figures(steps / elapsed, p50, p99, cpu / steps * 1e6, proxy_cpu / steps * 1e6, received / steps)


async def one_round(server: str, process: int, way: str, task: str, count: int, seconds: float) -> Figures:
    """Time one server with this many sessions."""
    sessions = [await open_session(PORTS[server], way, task, server == "echo") for _ in range(count)]
    return await time_sessions(sessions, [process], seconds)


@contextmanager
def running(other: Path | None) -> Generator[dict[str, int], None, None]:
    """Context manager of the running servers; its value is their process ids by name."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as started:
        init = [sys.executable, "-m", "openenv.cli", "init", "echo", "--output-dir", folder]
        subprocess.run(init, check=True, capture_output=True)
        echo = ECHO_SERVER.format(folder=folder, port=PORTS["echo"])
        commands = {"drone-env": our_server(ROOT, "drone-env", folder), "echo": ([sys.executable, "-c", echo], None)}
        if other is not None:
            commands["other"] = our_server(other.resolve(), "other", folder)
        servers: dict[str, subprocess.Popen[bytes]] = {}
        ports = [PORTS[name] for name in commands]
        for name, (command, environment) in commands.items():
            servers[name] = subprocess.Popen(command, env=environment)
            started.callback(servers[name].wait)
            started.callback(servers[name].terminate)
        eventually(lambda: any(server.poll() is not None for server in servers.values()) or all(map(is_taken, ports)))
        for name, server in servers.items():
            assert server.poll() is None, f"{name} has ended; is something else listening on port {PORTS[name]}?"
        yield {name: server.pid for name, server in servers.items()}


def our_server(checkout: Path, name: str, folder: str) -> tuple[list[str], dict[str, str]]:
    """The command and the environment of this project's server, from a checkout."""
    variables = {"DRONE_ENV_DATA": f"{folder}/{name}", "DRONE_ENV_CAPACITY": "4096", "PYTHONPATH": str(checkout)}
    command = [sys.executable, str(checkout / "drone_env/server/app.py"), "--port", str(PORTS[name])]
    return command, {**os.environ, **variables}


def main() -> None:
    """Time the servers and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="hard")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--sessions", type=int, nargs="+", default=[1, 8, 64, 256])
    parser.add_argument("--by", choices=WAYS, nargs="+", default=WAYS, help="how steps are sent")
    parser.add_argument("--other", type=Path, help="a second checkout of this project, timed in the same rounds")
    given = parser.parse_args()
    print(f"Task: {given.task}\n")
    print("| sessions | by | server | steps/s | p50 ms | p99 ms | server CPU us/step |\n|---|---|---|---|---|---|---|")
    with running(given.other) as processes:
        for sessions, way in itertools.product(given.sessions, given.by):
            rounds: dict[str, list[Figures]] = {name: [] for name in processes}
            for _ in range(given.rounds):
                for name, figures in rounds.items():
                    timed = one_round(name, processes[name], way, given.task, sessions, given.seconds)
                    figures.append(asyncio.run(timed))
            for name, figures in rounds.items():
                middle = Figures(*(statistics.median(column) for column in zip(*figures, strict=True)))
                print(
                    f"| {sessions} | {way} | {name} | {middle.steps_per_second:.0f} | {middle.p50_ms:.2f} "
                    f"| {middle.p99_ms:.2f} | {middle.cpu_us:.0f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
