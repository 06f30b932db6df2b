"""What a session and a step cost a server, its store and nginx, and what a million sessions would come to.

    python benchmarks/capacity.py [--task hard] [--sessions 1000] [--rounds 3] [--rate 1] [--json FILE]

One server process, nginx as `deploy` configures it, and a store are measured each by itself; shown is the median of the
rounds. CPU time is that of the processes, which other load on the machine changes less than it does the clock. The last
table is an extrapolation: measured figures times sessions, nothing else.
"""

import argparse
import asyncio
import json
import multiprocessing
import os
import sqlite3
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.server import MOVES, connect, cpu_seconds, frame  # noqa: E402
from drone_env.core.state_manager import Episode  # noqa: E402
from drone_env.core.tasks import get_task  # noqa: E402
from drone_env.episodes.store import FILE_NAME, Store  # noqa: E402
from tests.api.serving import Server, free_port  # noqa: E402
from tests.cluster.serving import COMMAND, Nginx  # noqa: E402

MILLION = 1_000_000
STEPS = 20
"""Flown in each session before anything is measured: a flight of the standard tasks lasts 7 to 160."""
ROWS = (10_000, 100_000)
TRANSACTIONS = 3_000


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


class Http:
    """A kept connection to a server, which counts its bytes.

    A library would take more time than the server does, on the same cores.
    """

    def __init__(self, port: int) -> None:
        self.port = port
        self.sent = self.received = 0

    async def open(self) -> None:
        """Connect."""
        self.reader, self.writer = await asyncio.open_connection("127.0.0.1", self.port, limit=1 << 20)

    async def post(self, path: str, body: dict[str, object], headers: dict[str, str]) -> bytes:
        """Send a request and return the body of its answer.

        Raises:
            ConnectionError: if the answer is a refusal.
        """
        content = json.dumps(body).encode()
        lines = [f"POST {path} HTTP/1.1", f"Host: 127.0.0.1:{self.port}", "Content-Type: application/json"]
        lines += [f"{name}: {value}" for name, value in headers.items()]
        request = "\r\n".join([*lines, f"Content-Length: {len(content)}", "", ""]).encode() + content
        self.writer.write(request)
        head = await self.reader.readuntil(b"\r\n\r\n")
        length = next(int(line[15:]) for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:"))
        answer = await self.reader.readexactly(length)
        if b" 200 " not in head[:16]:
            raise ConnectionError(answer.decode())
        self.sent += len(request)
        self.received += len(head) + length
        return answer


async def open_rows(port: int, task: str, count: int, steps: int) -> list[str]:
    """Open HTTP sessions over one connection, and fly some steps in each."""
    http = Http(port)
    await http.open()
    opened: list[str] = []
    for seed in range(count):
        session = json.loads(await http.post("/reset", {"task_name": task, "seed": seed}, {}))["session_id"]
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


class StoreFigures(NamedTuple):
    """What the store takes."""

    row_bytes: float
    """Of a session, with the page's share of the rest."""
    sweep_ms: dict[int, float]
    """Looking for idle sessions among so many, which every process does every 5 s while nobody else writes."""
    count_ms: dict[int, float]
    """Counting so many, which every new session does."""
    log_bytes: float
    """Written to SQLite's log for a step."""
    steps_per_second: dict[int, float]
    """Steps kept per second by so many processes together."""
    step_us: float
    """CPU time of keeping a step, in one process."""


def fill(folder: Path, task: str, counts: Sequence[int]) -> tuple[float, dict[int, float], dict[int, float]]:
    """Bytes of a session's row, milliseconds of a sweep and of a count, by how many rows there are."""
    known, sweep, counted = get_task(task), dict[int, float](), dict[int, float]()
    with Store(folder) as store, closing(sqlite3.connect(folder / FILE_NAME)) as copies:
        empty = folder_bytes(folder)
        with store.session(store.open_session(known.id, known.version, 1, "tiered", "bench", 1)) as row:
            row.actions = (0, 3, 1, 2) * (STEPS // 4)
        for count in counts:
            # Copies, under names as long as the store's: opening each would count all others each time.
            columns = "task, task_version, seed, reward_profile, agent, actions, episode_id, opened_at, touched_at"
            copies.execute(
                "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < ?) INSERT INTO sessions "
                f"SELECT lower(hex(randomblob(16))), {columns} FROM n, (SELECT * FROM sessions LIMIT 1)",
                (count - store.count_sessions(),),
            )
            copies.commit()
            assert store.count_sessions() == count
            sweep[count] = middle(lambda: store.expire_sessions(86_400.0))
            counted[count] = middle(store.count_sessions)
        copies.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        return (folder_bytes(folder) - empty) / counts[-1], sweep, counted


def folder_bytes(folder: Path) -> int:
    """Size of the store's file."""
    return (folder / FILE_NAME).stat().st_size


def middle(call: Callable[[], object], times: int = 7) -> float:
    """Median time of a call, in milliseconds."""
    taken: list[float] = []
    for _ in range(times):
        started = time.perf_counter()
        call()
        taken.append((time.perf_counter() - started) * 1000)
    return statistics.median(taken)


def write_steps(folder: Path, task: str, number: int, results: "multiprocessing.Queue[tuple[float, float]]") -> None:
    """Keep steps in sessions of one's own; tells the time and the CPU time of one."""
    known = get_task(task)
    with Store(folder) as store:
        names = [store.open_session(known.id, known.version, number, "tiered", "bench", MILLION) for _ in range(64)]
        clock, cpu = time.perf_counter(), time.process_time()
        for step in range(TRANSACTIONS):
            with store.session(names[step % 64]) as row:
                row.append(step % 4)
        results.put(((time.perf_counter() - clock) / TRANSACTIONS, (time.process_time() - cpu) / TRANSACTIONS))


def write_rates(folder: Path, task: str) -> tuple[dict[int, float], float]:
    """Steps kept per second by 1 and by 3 processes together, and CPU seconds of one."""
    spawn = multiprocessing.get_context("spawn")
    rates, cpu = dict[int, float](), 0.0
    for count in (1, 3):
        results = spawn.Queue()
        writers = [spawn.Process(target=write_steps, args=(folder, task, n, results)) for n in range(count)]
        for writer in writers:
            writer.start()
        told = [results.get() for _ in writers]
        for writer in writers:
            writer.join()
        rates[count] = sum(1 / seconds for seconds, _ in told)
        cpu = told[0][1] if count == 1 else cpu
    return rates, cpu


def log_bytes(folder: Path, task: str) -> float:
    """Bytes that a step adds to SQLite's log, from its length after the first steps since it was empty."""
    known, log = get_task(task), folder / f"{FILE_NAME}-wal"
    with Store(folder) as store:
        session = store.open_session(known.id, known.version, 1, "tiered", "bench", MILLION)
        before = log.stat().st_size
        for step in range(STEPS):
            with store.session(session) as row:
                row.append(step % 4)
        return (log.stat().st_size - before) / STEPS


def measure_store(task: str) -> StoreFigures:
    """Measure a store in a folder of its own."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        row_bytes, sweep, counted = fill(folder / "rows", task, ROWS)
        rates, cpu = write_rates(folder / "steps", task)
        return StoreFigures(row_bytes, sweep, counted, log_bytes(folder / "log", task), rates, cpu * 1e6)


def episode_bytes(task: str, count: int) -> float:
    """Bytes of an episode in flight, from the memory of this process."""

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


@contextmanager
def served(capacity: int) -> Generator[tuple[Server, Nginx], None, None]:
    """A server, and nginx before it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        settings = {"CAPACITY": str(capacity), "IDLE_SECONDS": "86400"}
        server = Server(COMMAND, folder / "data", free_port(), settings)
        try:
            with closing(Nginx(folder, [int(server.url.rpartition(":")[2])])) as nginx:
                yield server, nginx
        finally:
            server.kill()


class Figures(NamedTuple):
    """All that is measured."""

    server_bytes: float
    nginx_bytes: float
    live_http_bytes: float
    """Of an HTTP session whose episode a server has at hand."""
    live_http_files: float
    episode_bytes: float
    socket: SocketMemory
    http_direct: Wire
    http_proxied: Wire
    socket_proxied: Wire
    store: StoreFigures


def one_round(task: str, sessions: int, seconds: float) -> Figures:
    """Measure everything once."""
    store = measure_store(task)
    with served(sessions + 100) as (server, nginx):
        port, proxy = int(server.url.rpartition(":")[2]), int(nginx.url.rpartition(":")[2])
        processes, proxies = children(server.process.pid), children(nginx.process.pid)
        asyncio.run(open_rows(port, task, 20, STEPS))
        server_bytes, files, nginx_bytes = memory_of(processes), files_of(processes), memory_of(proxies)
        asyncio.run(open_rows(port, task, sessions, STEPS))
        live, live_files = memory_of(processes) - server_bytes, files_of(processes) - files
        direct = asyncio.run(time_http(port, task, processes, [], seconds))
        proxied = asyncio.run(time_http(proxy, task, processes, proxies, seconds))
    with served(sessions + 100) as (server, nginx):
        proxy = int(nginx.url.rpartition(":")[2])
        processes, proxies = children(server.process.pid), children(nginx.process.pid)
        socket, wire = asyncio.run(sockets(proxy, task, sessions, processes, proxies, seconds))
    return Figures(
        server_bytes,
        nginx_bytes,
        live / sessions,
        live_files / sessions,
        episode_bytes(task, sessions),
        socket,
        direct,
        proxied,
        wire,
        store,
    )


def median_of(rounds: Sequence[object]) -> object:
    """The median of every number in structures that are built alike."""
    first = rounds[0]
    if isinstance(first, tuple):
        return type(first)(*[median_of(column) for column in zip(*rounds, strict=True)])  # type: ignore[call-overload]
    if isinstance(first, dict):
        return {key: median_of([each[key] for each in rounds]) for key in first}  # type: ignore[index]
    return statistics.median(rounds)  # type: ignore[type-var]


def measured(figures: Figures) -> str:
    """What was measured, as a table."""
    store, socket, wires = figures.store, figures.socket, figures.socket_proxied
    kilo = 1000
    rows: list[tuple[str, str]] = [
        ("a server without sessions, private memory", f"{figures.server_bytes / 1e6:.0f} MB"),
        ("nginx, main process and workers", f"{figures.nginx_bytes / 1e6:.1f} MB"),
        ("an HTTP session that nobody steps: its row", f"{store.row_bytes:.0f} bytes of disk"),
        ("an HTTP session whose episode a server has at hand", f"{figures.live_http_bytes / kilo:.1f} KB"),
        ("of that, the episode", f"{figures.episode_bytes / kilo:.1f} KB"),
        ("a WebSocket, before its first reset", f"{socket.connected / kilo:.1f} KB"),
        (f"a WebSocket, after {STEPS} steps", f"{socket.flying / kilo:.1f} KB"),
        ("a WebSocket in nginx", f"{socket.nginx / kilo:.1f} KB"),
        ("open files for a WebSocket: server, nginx", f"{socket.server_files:.2f}, {socket.nginx_files:.2f}"),
        ("open files for an HTTP session without a request", f"{round(figures.live_http_files, 1) + 0.0:.1f}"),
        ("a step over HTTP: CPU of the server, directly", f"{figures.http_direct.server_us:.0f} us"),
        ("a step over HTTP: CPU of the server, through nginx", f"{figures.http_proxied.server_us:.0f} us"),
        ("a step over HTTP: CPU of nginx", f"{figures.http_proxied.nginx_us:.0f} us"),
        (
            "a step over HTTP: bytes sent, answered",
            f"{figures.http_proxied.sent:.0f}, {figures.http_proxied.received:.0f}",
        ),
        ("a step over WebSocket: CPU of the server, through nginx", f"{wires.server_us:.0f} us"),
        ("a step over WebSocket: CPU of nginx", f"{wires.nginx_us:.0f} us"),
        ("a step over WebSocket: bytes sent, answered", f"{wires.sent:.0f}, {wires.received:.0f}"),
        ("a step kept in the store: CPU", f"{store.step_us:.0f} us"),
        ("a step kept in the store: bytes of SQLite's log", f"{store.log_bytes:.0f}"),
        *[(f"steps kept per second, {n} processes", f"{rate:.0f}") for n, rate in store.steps_per_second.items()],
        *[(f"looking for idle sessions among {n:,}", f"{taken:.1f} ms") for n, taken in store.sweep_ms.items()],
        *[(f"counting {n:,} sessions for a new one", f"{taken:.2f} ms") for n, taken in store.count_ms.items()],
    ]
    return "\n".join(["| what | measured |", "|---|---|", *[f"| {name} | {value} |" for name, value in rows]])


def extrapolated(figures: Figures, rate: float) -> str:
    """What a million sessions would take, by multiplication."""
    store, http, ws = figures.store, figures.http_proxied, figures.socket_proxied
    steps = MILLION * rate
    written = max(store.steps_per_second.values())

    def cores(wire: Wire) -> tuple[float, float]:
        return steps * wire.server_us / 1e6, steps * wire.nginx_us / 1e6

    def gigabits(wire: Wire) -> float:
        return steps * (wire.sent + wire.received) * 8 / 1e9

    rows = [
        ("cores for the servers", f"{cores(http)[0]:.0f}", f"{cores(ws)[0]:.0f}"),
        ("cores for nginx", f"{cores(http)[1]:.0f}", f"{cores(ws)[1]:.0f}"),
        (
            "memory of the sessions in the servers",
            f"{MILLION * figures.live_http_bytes / 1e9:.1f} GB",
            f"{MILLION * figures.socket.flying / 1e9:.1f} GB",
        ),
        ("memory of their connections in nginx", "-", f"{MILLION * figures.socket.nginx / 1e9:.1f} GB"),
        (
            "open connections: servers, nginx",
            "those in use",
            f"{figures.socket.server_files:.0f} and {figures.socket.nginx_files:.0f} million",
        ),
        ("network, at the callers", f"{gigabits(http):.1f} Gbit/s", f"{gigabits(ws):.1f} Gbit/s"),
        ("disk for open sessions", f"{MILLION * store.row_bytes / 1e9:.2f} GB", "none"),
        ("written to SQLite's log", f"{steps * store.log_bytes / 1e9:.2f} GB/s", "ended episodes only"),
        ("stores (machines), by steps kept per second", f"{steps / written:.0f}", "-"),
    ]
    lines = [f"| a million sessions, {rate:g} steps/s each | HTTP | WebSocket |", "|---|---|---|"]
    return "\n".join([*lines, *[f"| {name} | {over_http} | {over_ws} |" for name, over_http, over_ws in rows]])


def main() -> None:
    """Measure, print, and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="hard")
    parser.add_argument("--sessions", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--rate", type=float, default=1.0, help="steps per second of each session (%(default)s)")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rounds: list[Figures] = []
    loads = [os.getloadavg()[0]]
    for number in range(given.rounds):
        print(f"round {number + 1} of {given.rounds}", file=sys.stderr, flush=True)
        rounds.append(one_round(given.task, given.sessions, given.seconds))
        loads.append(os.getloadavg()[0])
    figures = median_of(rounds)
    assert isinstance(figures, Figures)
    print(f"Task {given.task}, {given.sessions} sessions, median of {given.rounds} rounds, {os.cpu_count()} cores,")
    print(f"load of the machine {min(loads):.1f} to {max(loads):.1f} (this run included).\n")
    print(measured(figures), "\n", extrapolated(figures, given.rate), sep="\n")
    if given.json is not None:
        text = json.dumps({"load": loads, "rounds": rounds}, indent=2)
        given.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
