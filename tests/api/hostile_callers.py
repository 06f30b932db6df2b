"""Hostile callers against a server of their own: does it answer others meanwhile, and in how much memory?

    python tests/api/hostile_callers.py [--seconds 10]

A process of its own asks for `/health` all the time, each time over a new connection. In turn come floods of requests,
of long heads, of WebSocket frames, pings and one-byte fragments, some from callers that read nothing, and an end while
nobody reads. The check fails if the event loop used more than 0.2 CPU seconds before it answered `/health`, if the
server had more than 300 MB, or if it was not healthy or left a traceback (Linux).
"""

import argparse
import asyncio
import contextlib
import http.client
import multiprocessing
import socket
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.api.serving import Server, serving

MOST_LOOP_SECONDS, MOST_MEGABYTES = 0.2, 300
HEAD = "{} HTTP/1.1\r\nHost: 127.0.0.1\r\n"
UPGRADE = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {}\r\nSec-WebSocket-Version: 13\r\n\r\n"
HEADERS = b"".join([b"a%04d: x\r\n" % number for number in range(6500)])


class Flood(NamedTuple):
    """What callers send as fast as the server takes it; they connect again if it closes the connection."""

    name: str
    data: bytes
    path: str = ""
    """Of a WebSocket; requests if empty."""
    first: bytes = b""
    reads: bool = True


def masked(payload: bytes, first: int = 0x81) -> bytes:
    """A frame as clients send it, masked with zeros."""
    return bytes([first, 0x80 | len(payload)]) + bytes(4) + payload


FLOODS = [
    Flood("requests, no answer read", (HEAD.format("GET /x") + "\r\n").encode() * 2000, reads=False),
    Flood("requests with 6,500 headers", HEAD.format("GET /health").encode() + HEADERS + b"\r\n"),
    Flood("descriptions, no answer read", (HEAD.format("GET /openapi.json") + "\r\n").encode() * 50, reads=False),
    Flood("frames", masked(b'{"type":"mcp"}') * 5000, "/ws"),
    Flood("frames, no answer read", masked(b'{"type":"mcp"}') * 5000, "/ws", reads=False),
    Flood("frames of pages", masked(b'{"type":"pause"}') * 5000, "/live"),
    Flood("pings to /ws", masked(b"", 0x89) * 500, "/ws"),
    Flood("pings to /live", masked(b"", 0x89) * 500, "/live"),
    Flood("fragments to /ws", masked(b"x", 0) * 500, "/ws", masked(b"x", 1)),
    Flood("fragments to /live", masked(b"x", 0) * 500, "/live", masked(b"x", 1)),
]


def loop_seconds(process: int) -> float:
    """CPU seconds of a process's first thread, which runs the event loop."""
    return int(Path(f"/proc/{process}/schedstat").read_text(encoding="utf-8").split()[0]) / 1e9


def watch(port: int, process: int, told: Connection) -> None:
    """Ask for its health until it is gone; send when, the CPU seconds of the event loop meanwhile, and the fault."""
    while True:
        wrong = ""
        try:
            began, looped = time.monotonic(), loop_seconds(process)
            try:
                asked = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
                asked.request("GET", "/health")
                wrong = "" if asked.getresponse().status == 200 else "not healthy"
                asked.close()
            except OSError as error:
                wrong = repr(error)
            told.send((began, loop_seconds(process) - looped, wrong))
        except (OSError, IndexError):
            return
        time.sleep(0.02)


async def flood(port: int, one: Flood, until: float) -> int:
    """Send until a moment; return the number of connections that this took."""
    connections = 0
    while time.monotonic() < until:
        sock = socket.socket()
        sock.setblocking(False)
        for size in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            sock.setsockopt(socket.SOL_SOCKET, size, 1 << 15)
        await asyncio.get_running_loop().sock_connect(sock, ("127.0.0.1", port))
        reader, writer = await asyncio.open_connection(sock=sock)
        connections += 1
        with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.TimeoutError):
            if one.path:
                writer.write((HEAD.format(f"GET {one.path}") + UPGRADE.format("A" * 22 + "==")).encode())
                await reader.readuntil(b"\r\n\r\n")
            writer.write(one.first)
            reading = asyncio.create_task(swallow(reader)) if one.reads else None
            writer.transport.set_write_buffer_limits(0)
            while not (reading is not None and reading.done()):
                writer.write(one.data)
                await asyncio.wait_for(writer.drain(), until - time.monotonic())
        writer.transport.abort()
    return connections


async def swallow(reader: asyncio.StreamReader) -> None:
    with contextlib.suppress(OSError):
        while await reader.read(1 << 16):
            pass


async def attack(server: Server, seconds: float) -> list[str]:
    """Attack a server in each way, and end it during the last: what is wrong."""
    faults: list[str] = []
    process, port = server.process.pid, int(server.url.rpartition(":")[2])
    told, telling = multiprocessing.Pipe(duplex=False)
    multiprocessing.Process(target=watch, args=(port, process, telling), daemon=True).start()
    for one in FLOODS:
        until = time.monotonic() + seconds
        connections = sum(await asyncio.gather(*[flood(port, one, until) for _ in range(20)]))
        samples: list[tuple[float, float, str]] = []
        # Until one was asked after it: the last may still be on its way.
        while not samples or samples[-1][0] < until:
            while not told.poll():
                await asyncio.sleep(0.01)
            samples.append(told.recv())
        _, looped, wrong = (max(column) for column in zip(*samples, strict=True))
        times = f"{looped:6.3f} CPU s of the loop before /health at worst of {len(samples)}"
        print(f"{one.name:30} {times}; {connections:,} connections", flush=True)
        if looped > MOST_LOOP_SECONDS or wrong:
            faults.append(f"{one.name}: {looped:.2f} CPU s of the event loop before /health {wrong}")
    status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    most = int(status.partition("VmHWM:")[2].split()[0]) / 1024
    print(f"{'most memory of all the time':30} {most:.0f} MB", flush=True)
    if most > MOST_MEGABYTES:
        faults.append(f"the server had {most:.0f} MB")
    last = asyncio.gather(*[flood(port, FLOODS[0], time.monotonic() + 60) for _ in range(20)], return_exceptions=True)
    await asyncio.sleep(1)
    server.process.terminate()
    await asyncio.to_thread(server.process.wait, 60)
    await last
    return faults + ["tracebacks in the log"] * ("Traceback" in server.log.read_text(errors="replace"))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10, help="how long an attack lasts")
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder) / "data") as server:
        faults = asyncio.run(attack(server, parser.parse_args().seconds))
    for fault in faults:
        print(f"FAULT: {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
