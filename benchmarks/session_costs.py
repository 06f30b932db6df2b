"""What a session and a step cost a server process and nginx: memory, files, CPU time and bytes."""

import asyncio
import json
import multiprocessing
import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from benchmarks.server import MOVES, Http, connect, cpu_seconds, frame
from drone_env.core.episode import Episode

STEPS = 20
"""Flown in each session before anything is measured: a flight of the standard tasks lasts 7 to 160."""


class Wire(NamedTuple):
    """What a step over the network costs."""

    server_us: float
    """CPU time of the server."""
    nginx_us: float
    """CPU time of nginx; 0 where it is not asked."""
    sent: float
    """Bytes of the request, with headers, without those of TCP."""
    received: float
    """Bytes of the answer."""
    per_second: float


def children(process: int) -> list[int]:
    """A process and its children (Linux)."""
    told = Path(f"/proc/{process}/task/{process}/children").read_text(encoding="utf-8")
    return [process, *map(int, told.split())]


def cpu_of(processes: Iterable[int]) -> float:
    """CPU time of several processes together, in seconds."""
    return sum(cpu_seconds(process) for process in processes)


def memory_of(processes: Iterable[int]) -> int:
    """Memory that these processes share with nobody, in bytes (Linux)."""
    total = 0
    for process in processes:
        for line in Path(f"/proc/{process}/smaps_rollup").read_text(encoding="utf-8").splitlines():
            if line.startswith("Private_"):
                total += int(line.split()[1]) * 1024
    return total


def files_of(processes: Iterable[int]) -> int:
    """How many files and connections these processes have open (Linux)."""
    return sum(len(list(Path(f"/proc/{process}/fd").iterdir())) for process in processes)


async def open_rows(port: int, task: str, count: int, steps: int) -> list[str]:
    """Open HTTP sessions over one connection, and fly some steps in each."""
    http = Http(port)
    await http.open()
    opened: list[str] = []
    for seed in range(count):
        opening = await http.post("/reset", {"task_name": task, "seed": seed}, {"X-Session-Id": "new"})
        session = json.loads(opening)["session_id"]
        for step in range(steps):
            await http.post("/step", {"direction": MOVES[step % 4]}, {"X-Session-Id": session})
        opened.append(session)
    http.writer.close()
    return opened


async def time_http(port: int, task: str, server: list[int], nginx: list[int], seconds: float) -> Wire:
    """Step 16 sessions over a connection each, as fast as they are answered."""
    sessions = await open_rows(port, task, 16, 0)
    connections = [Http(port) for _ in sessions]
    for http in connections:
        await http.open()
    steps = 0

    async def fly(http: Http, session: str, until: float) -> None:
        nonlocal steps
        count = 0
        while time.perf_counter() < until:
            headers = {"X-Session-Id": session, "X-Step-Count": str(count)}
            answer = await http.post("/step", {"direction": MOVES[count % 4]}, headers)
            count, steps = count + 1, steps + 1
            if b'"done":true' in answer:
                await http.post("/reset", {"task_name": task}, {"X-Session-Id": session})
                count = 0

    before, proxy, started = cpu_of(server), cpu_of(nginx), time.perf_counter()
    await asyncio.gather(*[fly(*pair, started + seconds) for pair in zip(connections, sessions, strict=True)])
    elapsed = time.perf_counter() - started
    used, proxied = cpu_of(server) - before, cpu_of(nginx) - proxy
    sent, received = (sum(getattr(http, name) for http in connections) / steps for name in ("sent", "received"))
    for http in connections:
        http.writer.close()
    return Wire(used / steps * 1e6, proxied / steps * 1e6, sent, received, steps / elapsed)


Streams = list[tuple[asyncio.StreamReader, asyncio.StreamWriter]]


async def time_sockets(streams: Streams, task: str, server: list[int], nginx: list[int], seconds: float) -> Wire:
    """Step WebSocket sessions that have been reset, as fast as they are answered."""
    reset = frame({"type": "reset", "data": {"task_name": task}})
    moves = [frame({"type": "step", "data": {"direction": move}}) for move in MOVES]
    steps = sent = received = 0

    async def fly(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, until: float) -> None:
        nonlocal steps, sent, received
        while time.perf_counter() < until:
            move = moves[steps % 4]
            answer = await ask(reader, writer, move)
            steps, sent, received = steps + 1, sent + len(move), received + len(answer) + 4
            if b'"done":true' in answer:
                await ask(reader, writer, reset)

    before, proxy, started = cpu_of(server), cpu_of(nginx), time.perf_counter()
    await asyncio.gather(*[fly(*stream, started + seconds) for stream in streams])
    elapsed = time.perf_counter() - started
    used, proxied = cpu_of(server) - before, cpu_of(nginx) - proxy
    return Wire(used / steps * 1e6, proxied / steps * 1e6, sent / steps, received / steps, steps / elapsed)


async def ask(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, message: bytes) -> bytes:
    """Send a frame and read the answer; unlike that of `benchmarks/server.py`, answers pings, as a long run must.

    Raises:
        ConnectionError: if the server closes.
    """
    writer.write(message)
    while True:
        head = await reader.readexactly(2)
        length = head[1] & 0x7F
        if length >= 126:
            length = int.from_bytes(await reader.readexactly(2 if length == 126 else 8), "big")
        payload = await reader.readexactly(length)
        if head[0] == 0x81:
            return payload
        if head[0] == 0x88:
            raise ConnectionError(f"the server closed: {payload!r}")
        writer.write(bytes([0x8A, 0x80 | len(payload)]) + bytes(4) + payload)


async def first_steps(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, task: str) -> None:
    """Begin an episode over a WebSocket, and fly `STEPS` in it."""
    await ask(reader, writer, frame({"type": "reset", "data": {"task_name": task}}))
    for step in range(STEPS):
        await ask(reader, writer, frame({"type": "step", "data": {"direction": MOVES[step % 4]}}))


class SocketMemory(NamedTuple):
    """What an open WebSocket takes: bytes in the server before and after its flight, bytes and files in nginx."""

    connected: float
    flying: float
    nginx: float
    server_files: float
    nginx_files: float


async def sockets(
    port: int, task: str, count: int, server: list[int], nginx: list[int], seconds: float
) -> tuple[SocketMemory, Wire]:
    """Open WebSockets, fly `STEPS` in each, measure what they take; then step the first 16 of them."""
    # The first connections make what all others share.
    for reader, writer in [await connect(port) for _ in range(8)]:
        writer.close()
        await reader.read()
    start, proxy = memory_of(server), memory_of(nginx)
    files, proxy_files = files_of(server), files_of(nginx)
    streams = [await connect(port) for _ in range(count)]
    connected = memory_of(server)
    await asyncio.gather(*[first_steps(*stream, task) for stream in streams])
    taken = SocketMemory(
        (connected - start) / count,
        (memory_of(server) - start) / count,
        (memory_of(nginx) - proxy) / count,
        (files_of(server) - files) / count,
        (files_of(nginx) - proxy_files) / count,
    )
    wire = await time_sockets(streams[:16], task, server, nginx, seconds)
    for _, writer in streams:
        writer.close()
    return taken, wire


def episode_bytes(task: str, count: int) -> float:
    """Bytes of an episode in flight, from the memory of a process of its own."""
    with multiprocessing.get_context("spawn").Pool(1) as process:
        return process.apply(_episode_bytes, (task, count))


def _episode_bytes(task: str, count: int) -> float:
    def flown(seed: int) -> Episode:
        episode = Episode(task)
        episode.reset(seed)
        for step in range(STEPS):
            episode.step(step % 4)
        return episode

    warm = [flown(seed) for seed in range(50)]
    before = memory_of([os.getpid()])
    kept = [flown(seed) for seed in range(count)]
    grown = memory_of([os.getpid()]) - before
    del warm, kept
    return grown / count
