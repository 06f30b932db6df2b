"""Steps per second and latency of the server over WebSocket, beside OpenEnv's echo environment in the same run.

    python benchmarks/server.py [--task hard] [--seconds 5] [--rounds 3] [--sessions 1 8 64 256] [--json FILE]

The echo environment is the one that `openenv init` writes, served by OpenEnv's own server. Each server has one worker.
A session sends a step as soon as the last is answered. The load comes from this process, on the same machine; it speaks
the WebSocket protocol itself, as a library would take more time than the servers do. Rounds alternate between the
servers; shown is the median of the rounds.
"""

import argparse
import asyncio
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import httpx

ROOT = Path(__file__).parents[1]
PORTS = {"drone-env": 18_431, "echo": 18_432}
MOVES = ("UP", "LEFT", "DOWN", "RIGHT")
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
    """What one round comes to."""

    steps_per_second: float
    p50_ms: float
    p99_ms: float
    cpu_us: float
    """CPU time of the server for a step, which other load on the machine hardly changes."""


def frame(message: dict[str, Any]) -> bytes:
    """A text frame as clients send it, masked with zeros."""
    payload = json.dumps(message).encode()
    length = bytes([0x80 | len(payload)]) if len(payload) < 126 else bytes([0xFE]) + len(payload).to_bytes(2, "big")
    return b"\x81" + length + bytes(4) + payload


async def read_frame(reader: asyncio.StreamReader) -> bytes:
    """The payload of a text frame; pings are read over (a run is shorter than their patience).

    Raises:
        ConnectionError: if the server closes.
    """
    while True:
        head = await reader.readexactly(2)
        length = head[1] & 0x7F
        if length == 126:
            length = int.from_bytes(await reader.readexactly(2), "big")
        elif length == 127:
            length = int.from_bytes(await reader.readexactly(8), "big")
        payload = await reader.readexactly(length)
        if head[0] == 0x81:
            return payload
        if head[0] == 0x88:
            raise ConnectionError(f"the server closed: {payload!r}")


async def connect(port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """A WebSocket to `/ws`."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1 << 20)
    key = "AAAAAAAAAAAAAAAAAAAAAA=="
    writer.write(
        f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    answer = await reader.readuntil(b"\r\n\r\n")
    if b" 101 " not in answer:
        raise ConnectionError(answer.decode())
    return reader, writer


async def fly(
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
    reset: bytes,
    steps: list[bytes],
    until: float,
    latencies: list[float],
) -> None:
    """One session that has been reset: steps until the time is over, a new episode after each end."""
    clock, number = time.perf_counter, 0
    while (sent := clock()) < until:
        writer.write(steps[number % len(steps)])
        answer = await read_frame(reader)
        latencies.append(clock() - sent)
        number += 1
        if not answer.startswith(b'{"type":"observation"'):
            raise ConnectionError(answer[:200].decode())
        if b'"done":true' in answer:
            writer.write(reset)
            await read_frame(reader)


def cpu_seconds(process: int) -> float:
    """CPU time that a process has used (Linux)."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


async def one_round(name: str, process: int, task: str, sessions: int, seconds: float) -> Figures:
    """Time one server under this many sessions."""
    if name == "echo":
        reset, steps = frame({"type": "reset"}), [frame({"type": "step", "data": {"message": "RIGHT"}})]
    else:
        reset = frame({"type": "reset", "data": {"task_name": task}})
        steps = [frame({"type": "step", "data": {"direction": move}}) for move in MOVES]
    latencies: list[float] = []
    streams = [await connect(PORTS[name]) for _ in range(sessions)]
    for reader, writer in streams:
        writer.write(reset)
        await read_frame(reader)
    cpu, started = cpu_seconds(process), time.perf_counter()
    await asyncio.gather(*[fly(*stream, reset, steps, started + seconds, latencies) for stream in streams])
    elapsed, cpu = time.perf_counter() - started, cpu_seconds(process) - cpu
    for _, writer in streams:
        writer.close()
        await writer.wait_closed()
    ordered = sorted(latencies)
    p50, p99 = (ordered[int(share * (len(ordered) - 1))] * 1000 for share in (0.5, 0.99))
    return Figures(len(latencies) / elapsed, p50, p99, cpu / len(latencies) * 1e6)


@contextmanager
def both_servers() -> Generator[dict[str, int], None, None]:
    """Our server and the echo server, running: their process ids."""
    with tempfile.TemporaryDirectory() as folder:
        init = [sys.executable, "-m", "openenv.cli", "init", "echo", "--output-dir", folder]
        subprocess.run(init, check=True, capture_output=True)
        echo = ECHO_SERVER.format(folder=folder, port=PORTS["echo"])
        variables = {"DRONE_ENV_DATA": f"{folder}/data", "DRONE_ENV_CAPACITY": "1024", "PYTHONPATH": str(ROOT)}
        environment = {**os.environ, **variables}
        ours = [sys.executable, str(ROOT / "drone_env/server/app.py"), "--port", str(PORTS["drone-env"])]
        servers = [subprocess.Popen(ours, env=environment), subprocess.Popen([sys.executable, "-c", echo])]
        try:
            for server, port in zip(servers, PORTS.values(), strict=True):
                wait_for(server, port)
            yield {name: server.pid for name, server in zip(PORTS, servers, strict=True)}
        finally:
            for server in servers:
                server.terminate()
            for server in servers:
                server.wait()


def wait_for(server: subprocess.Popen[bytes], port: int) -> None:
    """Wait until a server is healthy.

    Raises:
        RuntimeError: if it has ended, such as when another has its port.
        TimeoutError: if it is not healthy within a minute.
    """
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline:
        try:
            if httpx.get(f"http://127.0.0.1:{port}/health").status_code == 200 and server.poll() is None:
                return
        except httpx.HTTPError:
            time.sleep(0.1)
        if server.poll() is not None:
            raise RuntimeError(f"the server for port {port} has ended; is something else listening there?")
    raise TimeoutError(f"no server on port {port}")


def main() -> None:
    """Time, print, and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="hard")
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--sessions", type=int, nargs="+", default=[1, 8, 64, 256])
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    report: list[dict[str, Any]] = []
    print(f"Task: {given.task}\n")
    print("| sessions | server | steps/s | p50 ms | p99 ms | server CPU us/step |\n|---|---|---|---|---|---|")
    with both_servers() as processes:
        for sessions in given.sessions:
            rounds: dict[str, list[Figures]] = {name: [] for name in PORTS}
            for _ in range(given.rounds):
                for name, figures in rounds.items():
                    figures.append(asyncio.run(one_round(name, processes[name], given.task, sessions, given.seconds)))
            for name, figures in rounds.items():
                rate, p50, p99, cpu = (statistics.median(column) for column in zip(*figures, strict=True))
                print(f"| {sessions} | {name} | {rate:.0f} | {p50:.2f} | {p99:.2f} | {cpu:.0f} |", flush=True)
                report.append({"sessions": sessions, "server": name, "rounds": [f._asdict() for f in figures]})
    if given.json is not None:
        given.json.write_text(json.dumps({"task": given.task, "report": report}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
