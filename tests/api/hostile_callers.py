"""Hostile callers against a server of their own: does it answer others meanwhile, and in how much memory?

    python tests/api/hostile_callers.py [--seconds 10]

A process of its own asks for `/health` all the time, each time over a new connection. In turn come 20 callers that
send requests and read nothing, 1,000 that send half a request, floods over WebSocket, requests with thousands of
headers, floods of pings and of one-byte fragments, followers of the request log, callers that read slowly or not at
all, and an end while nobody reads. It fails if `/health` took longer than 0.5 s or the event loop used more than 0.2
CPU seconds before it answered; if a request or connection cost the loop more than 5 ms; if the server had more than
300 MB; if half requests stay; or if a traceback was logged.

The time of an answer is counted without that for which server or asker could have run while the machine was busy with
others (`/proc/PID/task/*/schedstat`, Linux), but never as less than the server's own CPU time meanwhile. The whole time
is shown beside it, and a quiet server's for comparison.
"""

import argparse
import asyncio
import contextlib
import http.client
import multiprocessing
import os
import socket
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from multiprocessing.connection import Connection
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.api.raw import MORE, PING, TEXT, masked
from tests.api.serving import Server, serving

MOST_SECONDS, MOST_LOOP_SECONDS, MOST_LOOP_SECONDS_EACH = 0.5, 0.2, 0.005
MOST_MEGABYTES = 300
HEAD = "{} HTTP/1.1\r\nHost: 127.0.0.1\r\n"
UPGRADE = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: {}\r\nSec-WebSocket-Version: 13\r\n\r\n"
Streams = tuple[asyncio.StreamReader, asyncio.StreamWriter]


def megabytes(process: int, what: str) -> float:
    """A size of a process (Linux): `VmRSS` now, `VmHWM` the most."""
    status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    return int(status.partition(f"{what}:")[2].split()[0]) / 1024


def scheduled(process: int) -> tuple[float, float]:
    """Seconds for which the threads of a process have run, and for which they could have and others had the cores."""
    ran = waited = 0
    for file in Path(f"/proc/{process}/task").glob("*/schedstat"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):  # a thread that has ended meanwhile
            of_thread = file.read_text(encoding="utf-8").split()
            ran, waited = ran + int(of_thread[0]), waited + int(of_thread[1])
    return ran / 1e9, waited / 1e9


def loop_seconds(process: int) -> float:
    """CPU seconds of a process's first thread, which runs the event loop (Linux)."""
    return int(Path(f"/proc/{process}/schedstat").read_text(encoding="utf-8").split()[0]) / 1e9


def watch(port: int, process: int, told: Connection) -> None:
    """Ask for its health until it is gone, and send the figures of each answer.

    They are: when, seconds, seconds on a free machine, CPU seconds of the event loop, megabytes, what is wrong.
    """
    while True:
        wrong = ""
        try:
            (ran, waited), (_, own), began = scheduled(process), scheduled(os.getpid()), time.monotonic()
            looped = loop_seconds(process)
            try:
                asked = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
                asked.request("GET", "/health")
                wrong = "" if asked.getresponse().status == 200 else "not healthy"
                asked.close()
            except OSError as error:
                wrong = repr(error)
            took, looped = time.monotonic() - began, loop_seconds(process) - looped
            (ran_since, waited_since), (_, own_since) = scheduled(process), scheduled(os.getpid())
            # Threads wait side by side, so what they waited for together may be more than was lost.
            free = min(took, max(ran_since - ran, took - (waited_since - waited) - (own_since - own)))
            told.send((began, took, free, looped, megabytes(process, "VmRSS"), wrong))
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
        samples: list[tuple[float, float, float, float, float, str]] = []
        # Until one was asked after it: the last may still be on its way.
        while not samples or samples[-1][0] < ended:
            while not self.told.poll():
                await asyncio.sleep(0.01)
            samples.append(self.told.recv())
        _, slowest, worst, looped, most, _ = (max(column) for column in zip(*samples, strict=True))
        wrong = Counter(s[5] for s in samples if s[5])
        times = f"{worst:6.3f} s at worst of {len(samples):4} ({slowest:6.3f} s with waits for a core)"
        times += f", {looped:6.3f} CPU s of the loop"
        print(f"{name:34} /health {times}, {most:4.0f} MB; {note}", flush=True)
        if worst > MOST_SECONDS:
            self.faults.append(f"{name}: /health took {worst:.2f} s")
        if looped > MOST_LOOP_SECONDS:
            self.faults.append(f"{name}: the event loop used {looped:.2f} CPU s before it answered /health")
        self.faults += [f"{name}: /health: {what}, {times} times" for what, times in wrong.items()]

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

    async def send_halves(self) -> str:
        head = HEAD.format("POST /step") + "Content-Type: application/json\r\n"
        halves = [head[:20], head, head + "Content-Length: 20\r\n\r\n", head + 'Content-Length: 20\r\n\r\n{"direc']
        streams = [await self.open(halves[number % 4].encode()) for number in range(1000)]
        began = time.monotonic()
        ends = [asyncio.wait_for(reader.read(), 90) for reader, _ in streams]
        ended = [
            end
            for end in await asyncio.gather(*ends, return_exceptions=True)
            if not isinstance(end, asyncio.TimeoutError)
        ]
        abort(streams)
        if len(ended) < 1000:
            self.faults.append(f"{1000 - len(ended)} half requests stay")
        return f"{len(ended)} of 1,000 halves were ended within {time.monotonic() - began:.0f} s"

    async def flood(
        self, path: str, frame: bytes, first: bytes = b"", callers: int = 10, reads: bool = True, is_abuse: bool = False
    ) -> str:
        """Send as many frames as the server takes, from callers that connect again when it closes.

        Args:
            path: The WebSocket; empty to send requests.
            frame: The bytes to repeat.
            first: Bytes to send before them.
            callers: How many send it.
            reads: Whether they read the answers.
            is_abuse: Whether the server closes the connection; then the cost is counted for each connection.
        """

        async def act(until: float) -> int:
            reader, writer = await (self.open_socket(path) if path else self.open())
            reading = asyncio.create_task(swallow(reader)) if reads else None
            if reading is None:
                reader._transport.pause_reading()  # pyright: ignore
            writer.write(first)
            taken = await self.push(writer, frame * (500 if is_abuse else 100_000 // len(frame)), 1_000_000, until)
            writer.transport.abort()
            if reading is not None:
                await asyncio.gather(reading, return_exceptions=True)
            return 1 if is_abuse else taken // len(frame)

        return await self.repeat(callers, act)

    async def ask(self, request: bytes) -> int:
        """Send a request, and read the first line of the answer."""
        reader, writer = await self.open(request)
        with contextlib.suppress(OSError):  # the server may close before it has read everything
            await reader.readline()
        writer.transport.abort()
        return 1

    async def send_long_heads(self) -> str:
        """Send requests with 6,500 headers, from 128 callers."""
        headers = b"".join([b"a%04d: x\r\n" % number for number in range(6500)])
        request = HEAD.format("GET /health").encode() + headers + b"\r\n"
        return await self.repeat(128, lambda _: self.ask(request))

    async def follow_requests(self) -> str:
        """Read the request log with 296 callers while 8 others call."""
        request = (HEAD.format("GET /terminal_logs") + "Accept: text/event-stream\r\n\r\n").encode()
        streams = [await self.open(request) for _ in range(296)]
        statuses = Counter([(await reader.readline())[9:12].decode() for reader, _ in streams])
        readers = [asyncio.create_task(swallow(reader)) for reader, _ in streams]
        note = await self.repeat(8, lambda _: self.ask((HEAD.format("GET /x") + "\r\n").encode()))
        abort(streams)
        await asyncio.gather(*readers, return_exceptions=True)
        return f"readers by status: {dict(statuses)}; requests: {note}"

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
        until, read = time.monotonic() + self.seconds, 0
        while time.monotonic() < until:
            for reader, _ in streams:
                read += len(await reader.read(1))
            await asyncio.sleep(0.2)
        abort(streams)
        return f"{read} bytes read by 40"

    async def end(self) -> None:
        """End it while nobody reads."""
        streams = [await self.open((HEAD.format("GET /openapi.json") + "\r\n").encode() * 200) for _ in range(100)]
        sockets = [await self.open_socket("/ws") for _ in range(10)]
        for reader, _ in streams + sockets:
            reader._transport.pause_reading()  # pyright: ignore
        frames = masked(b'{"type":"none"}') * 5000
        await asyncio.gather(*[self.push(writer, frames, 20, time.monotonic() + 2) for _, writer in sockets])
        most = megabytes(self.server.process.pid, "VmHWM")
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


def abort(streams: list[Streams]) -> None:
    for _, writer in streams:
        writer.transport.abort()


async def swallow(reader: asyncio.StreamReader) -> None:
    while await reader.read(1 << 16):
        pass


async def go(server: Server, seconds: float) -> list[str]:
    campaign = Campaign(server, seconds)
    quiet = asyncio.sleep(seconds / 2, "nobody else calls")
    await campaign.under("quiet", quiet)
    request = (HEAD.format("GET /x") + "\r\n").encode()
    await campaign.under("requests sent, none read", campaign.flood("", request, callers=20, reads=False))
    await campaign.under("half requests", campaign.send_halves())
    frame = masked(b'{"type":"none"}')
    await campaign.under("flood of frames", campaign.flood("/ws", frame))
    await campaign.under("flood of frames, no answer read", campaign.flood("/ws", frame, reads=False))
    await campaign.under("flood of pings, no answer read", campaign.flood("/ws", masked(b"x" * 100, 9), reads=False))
    await campaign.under("requests with 6,500 headers", campaign.send_long_heads())
    await campaign.under("flood of pings", campaign.flood("/ws", PING, callers=64))
    await campaign.under("one-byte fragments", campaign.flood("/ws", MORE, TEXT, callers=64, is_abuse=True))
    await campaign.under("readers of the request log", campaign.follow_requests())
    await campaign.under("slow readers", campaign.read_slowly())
    await campaign.end()
    return campaign.faults


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10, help="how long an attack lasts")
    given = parser.parse_args()
    print(f"load of the machine before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory() as folder, serving(Path(folder) / "data") as server:
        faults = asyncio.run(go(server, given.seconds))
    for fault in faults:
        print(f"FAULT: {fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
