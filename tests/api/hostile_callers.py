"""Hostile callers against a server of their own: does it answer others meanwhile, and in how much memory?

    python tests/api/hostile_callers.py [--seconds 10]

A process of its own asks for `/health` all the time, each time over a new connection. In turn come 20 callers that
send 26 MB of requests and read nothing, floods over WebSocket, requests with thousands of headers, floods of pings and
of one-byte fragments, callers that read slowly or not at all, and an end while nobody reads. It fails if the event loop
used more than 0.2 CPU seconds before it answered `/health`; if a request or connection cost the loop more than 5 ms; if
the server had more than 300 MB; or if it was not healthy or left a traceback.
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
from collections.abc import Awaitable, Callable
from multiprocessing.connection import Connection
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.api.serving import Server, serving

MOST_LOOP_SECONDS, MOST_LOOP_SECONDS_EACH, MOST_MEGABYTES = 0.2, 0.005, 300
HEAD = "{} HTTP/1.1\r\nHost: 127.0.0.1\r\n"
UPGRADE = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {}\r\nSec-WebSocket-Version: 13\r\n\r\n"
PING, BEGIN, GO_ON = b"\x89\x80" + bytes(4), b"\x01\x81" + bytes(4) + b"x", b"\x00\x81" + bytes(4) + b"x"
"""Masked frames: a ping without payload, and one-byte fragments of a text."""
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


def megabytes(process: int) -> float:
    """The most memory that a process has had (Linux)."""
    status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


def loop_seconds(process: int) -> float:
    """CPU seconds of a process's first thread, which runs the event loop (Linux)."""
    return int(Path(f"/proc/{process}/schedstat").read_text(encoding="utf-8").split()[0]) / 1e9


def watch(port: int, process: int, told: Connection) -> None:
    """Ask for its health until it is gone; send when, the seconds it took, CPU seconds of the event loop, the fault."""
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
            told.send((began, time.monotonic() - began, loop_seconds(process) - looped, wrong))
        except (OSError, IndexError):
            return
        time.sleep(0.02)


class Campaign:
    """What is done to a server, and how it took that."""

    def __init__(self, server: Server, seconds: float) -> None:
        self.server = server
        self.seconds = seconds
        self.port = int(server.url.rpartition(":")[2])
        self.faults: list[str] = []
        self.told, telling = multiprocessing.Pipe(duplex=False)
        self.watcher = multiprocessing.Process(target=watch, args=(self.port, server.process.pid, telling), daemon=True)
        self.watcher.start()

    async def under(self, name: str, attack: Awaitable[str]) -> None:
        """Attack, and print how the server did."""
        note = await attack
        ended = time.monotonic()
        samples: list[tuple[float, float, float, str]] = []
        # Until one was asked after it: the last may still be on its way.
        while not samples or samples[-1][0] < ended:
            while not self.told.poll():
                await asyncio.sleep(0.01)
            samples.append(self.told.recv())
        _, slowest, looped, wrong = (max(column) for column in zip(*samples, strict=True))
        times = f"{slowest:6.3f} s and {looped:6.3f} CPU s of the loop at worst of {len(samples):4}"
        print(f"{name:34} /health {times}; {note}", flush=True)
        if looped > MOST_LOOP_SECONDS:
            self.faults.append(f"{name}: the event loop used {looped:.2f} CPU s before it answered /health")
        if wrong:
            self.faults.append(f"{name}: /health: {wrong}")

    async def open(self, data: bytes = b"", limit: int = 1 << 16) -> Streams:
        """A connection on which this was sent, and which keeps little of what is on its way."""
        sock = socket.socket()
        sock.setblocking(False)
        for size in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            sock.setsockopt(socket.SOL_SOCKET, size, 1 << 15)
        await asyncio.get_running_loop().sock_connect(sock, ("127.0.0.1", self.port))
        reader, writer = await asyncio.open_connection(sock=sock, limit=limit)
        writer.write(data)
        return reader, writer

    async def open_socket(self, path: str) -> Streams:
        """A WebSocket."""
        reader, writer = await self.open((HEAD.format(f"GET {path}") + UPGRADE.format("A" * 22 + "==")).encode())
        await reader.readuntil(b"\r\n\r\n")
        return reader, writer

    async def push(self, writer: asyncio.StreamWriter, data: bytes, times: int, until: float) -> int:
        """Send the same again and again, as long as the server takes it: the bytes that it took."""
        writer.transport.set_write_buffer_limits(0)
        for sent in range(times):
            writer.write(data)
            try:
                await asyncio.wait_for(writer.drain(), until - time.monotonic())
            except (asyncio.TimeoutError, OSError):
                return sent * len(data)
        return times * len(data)

    async def pipeline(self) -> str:
        request = (HEAD.format("GET /x") + "\r\n").encode()
        streams = [await self.open() for _ in range(20)]
        data, until = request * (100_000 // len(request)), time.monotonic() + self.seconds
        # As many bytes as 26 MB, also where it answers too fast.
        pushes = [self.push(writer, data, 26_000_000 // len(data), until) for _, writer in streams]
        for reader, _ in streams:
            reader._transport.pause_reading()  # pyright: ignore
        taken = await asyncio.gather(*pushes)
        abort(streams)
        return f"{sum(taken) / 1e6:.0f} MB taken from 20 that read nothing"

    async def flood(self, frame: bytes, reads: bool, path: str = "/ws") -> str:
        streams = [await self.open_socket(path) for _ in range(10)]
        until = time.monotonic() + self.seconds
        readers = [asyncio.create_task(swallow(reader)) for reader, _ in streams if reads]
        if not reads:
            for reader, _ in streams:
                reader._transport.pause_reading()  # pyright: ignore
        data = frame * (100_000 // len(frame))
        taken = await asyncio.gather(*[self.push(writer, data, 10_000, until) for _, writer in streams])
        for task in readers:
            task.cancel()
        abort(streams)
        return f"{sum(taken) / len(frame):,.0f} frames taken from 10"

    async def send_long_heads(self) -> str:
        """Send requests with 6,500 headers, from 128 callers."""
        headers = b"".join([b"a%04d: x\r\n" % number for number in range(6500)])
        request = HEAD.format("GET /health").encode() + headers + b"\r\n"

        async def ask(_: float) -> int:
            reader, writer = await self.open(request)
            with contextlib.suppress(OSError):  # the server may close before it has read everything
                await reader.readline()
            writer.transport.abort()
            return 1

        return await self.repeat(128, ask)

    async def send_small_frames(self, path: str, first: bytes, frame: bytes) -> str:
        """Send as many frames as the server takes, from 64 callers that connect again when it closes."""

        async def flood(until: float) -> int:
            reader, writer = await self.open_socket(path)
            reading = asyncio.create_task(swallow(reader))
            writer.write(first)
            await self.push(writer, frame * 500, 1_000_000, until)
            writer.transport.abort()
            await asyncio.gather(reading, return_exceptions=True)
            return 1

        return await self.repeat(64, flood)

    async def repeat(self, callers: int, act: Callable[[float], Awaitable[int]]) -> str:
        """Have callers act until the time is over: how often they did, and what that cost the event loop."""
        process, until, done = self.server.process.pid, time.monotonic() + self.seconds, 0
        before = loop_seconds(process)

        async def go_on() -> None:
            nonlocal done
            while time.monotonic() < until:
                with contextlib.suppress(OSError, asyncio.IncompleteReadError):
                    acted = await act(until)
                    done += acted

        await asyncio.gather(*[go_on() for _ in range(callers)])
        each = (loop_seconds(process) - before) / max(done, 1)
        if each > MOST_LOOP_SECONDS_EACH:
            self.faults.append(f"each of {done:,} cost the event loop {each * 1000:.1f} ms")
        return f"{done:,} from {callers}, {each * 1000:.3f} ms of the event loop each"

    async def read_slowly(self) -> str:
        page = (HEAD.format("GET /") + "\r\n").encode() * 50
        script = (HEAD.format("GET /openapi.json") + "\r\n").encode() * 50
        streams = [await self.open(page if number % 2 else script, limit=16) for number in range(40)]
        streams += [await self.open_socket("/live") for _ in range(10)]
        for _, writer in streams[40:]:
            writer.write(masked(b'{"type":"subscribe","topics":["requests","episodes"]}'))
        until, read = time.monotonic() + self.seconds, 0
        while time.monotonic() < until:
            for reader, _ in streams[:40]:
                read += len(await reader.read(1))
            await asyncio.sleep(0.2)
        abort(streams)
        return f"{read} bytes read by 40, and none by 10 pages"

    async def end(self) -> None:
        """End it while nobody reads."""
        streams = [await self.open((HEAD.format("GET /openapi.json") + "\r\n").encode() * 200) for _ in range(100)]
        sockets = [await self.open_socket("/ws") for _ in range(10)]
        for reader, _ in streams + sockets:
            reader._transport.pause_reading()  # pyright: ignore
        frames = masked(b'{"type":"mcp"}') * 5000
        await asyncio.gather(*[self.push(writer, frames, 20, time.monotonic() + 2) for _, writer in sockets])
        most = megabytes(self.server.process.pid)
        if most > MOST_MEGABYTES:
            self.faults.append(f"the server had {most:.0f} MB")
        print(f"{'most memory of all the time':34} {most:.0f} MB", flush=True)
        self.server.process.terminate()
        began = time.monotonic()
        with contextlib.suppress(Exception):
            await asyncio.to_thread(self.server.process.wait, 60)
        print(f"{'asked to end':34} {time.monotonic() - began:.1f} s, with {self.server.process.poll()}", flush=True)
        abort(streams + sockets)
        told = self.server.log.read_text(errors="replace")
        print(f"{'its log':34} {told.count(chr(10))} lines, {told.count('Traceback')} tracebacks", flush=True)
        if "Traceback" in told:
            self.faults.append(f"tracebacks in the log: {told[told.index('Traceback') :][:3000]}")


def masked(payload: bytes, opcode: int = 1) -> bytes:
    """A frame as clients send it, masked with zeros."""
    return bytes([0x80 | opcode, 0x80 | len(payload)]) + bytes(4) + payload


def abort(streams: list[Streams]) -> None:
    for _, writer in streams:
        writer.transport.abort()


async def swallow(reader: asyncio.StreamReader) -> None:
    while await reader.read(1 << 16):
        pass


async def go(server: Server, seconds: float) -> list[str]:
    campaign = Campaign(server, seconds)
    await campaign.under("quiet", asyncio.sleep(seconds / 2, "nobody else calls"))
    await campaign.under("requests sent, none read", campaign.pipeline())
    await campaign.under("flood of frames", campaign.flood(masked(b'{"type":"mcp"}'), True))
    await campaign.under("flood of frames, no answer read", campaign.flood(masked(b'{"type":"mcp"}'), False))
    await campaign.under("flood of frames of pages", campaign.flood(masked(b'{"type":"pause"}'), True, "/live"))
    await campaign.under("flood of pings, no answer read", campaign.flood(masked(b"x" * 100, 9), False))
    await campaign.under("requests with 6,500 headers", campaign.send_long_heads())
    for path in ("/ws", "/live"):
        await campaign.under(f"pings to {path}", campaign.send_small_frames(path, PING, PING))
        await campaign.under(f"one-byte fragments to {path}", campaign.send_small_frames(path, BEGIN, GO_ON))
    await campaign.under("slow readers", campaign.read_slowly())
    await campaign.end()
    return campaign.faults


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10, help="how long an attack lasts")
    seconds = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder) / "data") as server:
        faults = asyncio.run(go(server, seconds))
    for fault in faults:
        print(f"FAULT: {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
