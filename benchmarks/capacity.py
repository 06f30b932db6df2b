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
import statistics
import sys
import tempfile
from collections.abc import Generator, Iterable, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.server import (  # noqa: E402
    MOVES,
    NEW,
    Figures,
    Http,
    Session,
    Socket,
    frame,
    open_session,
    time_sessions,
)
from benchmarks.store_costs import STEPS, StoreFigures, measure_store  # noqa: E402
from drone_env.core.episode import Episode  # noqa: E402
from tests.api.serving import Server  # noqa: E402
from tests.cluster.serving import COMMAND, Nginx  # noqa: E402
from tests.tools import reserved_port  # noqa: E402

MILLION = 1_000_000


@contextmanager
def served(capacity: int) -> Generator[tuple[Server, Nginx], None, None]:
    """A server, and nginx before it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        settings = {"CAPACITY": str(capacity), "IDLE_SECONDS": "86400"}
        server = Server(COMMAND, folder / "data", reserved_port(), settings)
        try:
            with closing(Nginx(folder, [int(server.url.rpartition(":")[2])])) as nginx:
                yield server, nginx
        finally:
            server.kill()


def children(process: int) -> list[int]:
    """A process and its children (Linux)."""
    listed = Path(f"/proc/{process}/task/{process}/children").read_text(encoding="utf-8")
    return [process, *map(int, listed.split())]


def memory_of(processes: Iterable[int]) -> int:
    """Memory that these processes share with nobody, in bytes (Linux)."""
    total = 0
    for process in processes:
        for line in Path(f"/proc/{process}/smaps_rollup").read_text(encoding="utf-8").splitlines():
            if line.startswith("Private_"):
                total += int(line.split()[1]) * 1024
    return total


def files_of(processes: Iterable[int]) -> int:
    """Return the number of open files and connections of these processes (Linux)."""
    return sum(len(list(Path(f"/proc/{process}/fd").iterdir())) for process in processes)


async def open_rows(port: int, task: str, count: int) -> None:
    """Open HTTP sessions over one connection, and fly `STEPS` in each."""
    http = Http(port)
    await http.open()
    for seed in range(count):
        opening = await http.ask(http.request("/reset", {"task_name": task, "seed": seed}, NEW))
        named = {"X-Session-Id": json.loads(opening)["session_id"]}
        for step in range(STEPS):
            await http.ask(http.request("/step", {"direction": MOVES[step % 4]}, named))
    await http.close()


async def time_http(port: int, task: str, server: list[int], proxy: list[int], seconds: float) -> Figures:
    """Step 16 HTTP sessions as fast as they are answered."""
    return await time_sessions([await open_session(port, "HTTP", task) for _ in range(16)], server, seconds, proxy)


class SocketMemory(NamedTuple):
    """Cost of an open WebSocket: bytes in the server before and after its flight, bytes and files in nginx."""

    connected: float
    flying: float
    nginx: float
    server_files: float
    nginx_files: float


async def sockets(
    port: int, task: str, count: int, server: list[int], proxy: list[int], seconds: float
) -> tuple[SocketMemory, Figures]:
    """Open WebSockets, fly `STEPS` in each, measure what they take; then step the first 16 of them."""
    # The first connections make what all others share.
    for session in [await open_session(port, "WebSocket", task) for _ in range(8)]:
        await session.connection.close()
    start, proxy_start = memory_of(server), memory_of(proxy)
    files, proxy_files = files_of(server), files_of(proxy)
    opened = [Socket(port) for _ in range(count)]
    for socket in opened:
        await socket.open()
    connected = memory_of(server)
    reset = frame({"type": "reset", "data": {"task_name": task}})
    moves = [frame({"type": "step", "data": {"direction": move}}) for move in MOVES]

    async def first_steps(socket: Socket) -> None:
        for message in (reset, *moves * (STEPS // 4)):
            await socket.ask(message)

    await asyncio.gather(*map(first_steps, opened))
    taken = SocketMemory(
        (connected - start) / count,
        (memory_of(server) - start) / count,
        (memory_of(proxy) - proxy_start) / count,
        (files_of(server) - files) / count,
        (files_of(proxy) - proxy_files) / count,
    )
    wire = await time_sessions([Session(socket, reset, moves) for socket in opened[:16]], server, seconds, proxy)
    for socket in opened[16:]:
        await socket.close()
    return taken, wire


def episode_bytes(task: str, count: int) -> float:
    """Return the bytes of an episode in flight, measured in a separate process."""
    with multiprocessing.get_context("spawn").Pool(1) as process:
        return process.apply(_episode_bytes, (task, count))


def _episode_bytes(task: str, count: int) -> float:
    def flown(seed: int) -> Episode:
        return Episode(task, seed=seed).fly(step % 4 for step in range(STEPS))

    warm = [flown(seed) for seed in range(50)]
    before = memory_of([os.getpid()])
    kept = [flown(seed) for seed in range(count)]
    grown = memory_of([os.getpid()]) - before
    del warm, kept
    return grown / count


class Costs(NamedTuple):
    """All measurements."""

    server_bytes: float
    nginx_bytes: float
    live_http_bytes: float
    """Of an HTTP session whose episode a server has at hand."""
    live_http_files: float
    episode_bytes: float
    socket: SocketMemory
    http_direct: Figures
    http_proxied: Figures
    socket_proxied: Figures
    store: StoreFigures


def one_round(task: str, sessions: int, seconds: float) -> Costs:
    """Measure everything once."""
    store = measure_store(task)
    with served(sessions + 100) as (server, nginx):
        port, proxy = int(server.url.rpartition(":")[2]), int(nginx.url.rpartition(":")[2])
        processes, proxies = children(server.process.pid), children(nginx.process.pid)
        asyncio.run(open_rows(port, task, 20))
        server_bytes, files, nginx_bytes = memory_of(processes), files_of(processes), memory_of(proxies)
        asyncio.run(open_rows(port, task, sessions))
        live, live_files = memory_of(processes) - server_bytes, files_of(processes) - files
        direct = asyncio.run(time_http(port, task, processes, [], seconds))
        proxied = asyncio.run(time_http(proxy, task, processes, proxies, seconds))
    with served(sessions + 100) as (server, nginx):
        proxy = int(nginx.url.rpartition(":")[2])
        processes, proxies = children(server.process.pid), children(nginx.process.pid)
        socket, wire = asyncio.run(sockets(proxy, task, sessions, processes, proxies, seconds))
    return Costs(
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


def median_of(rounds: Sequence[Any]) -> Any:
    """The median of every number in named tuples and dictionaries that are built alike."""
    first = rounds[0]
    if hasattr(first, "_make"):
        return first._make([median_of(column) for column in zip(*rounds, strict=True)])
    if hasattr(first, "keys"):
        return {key: median_of([each[key] for each in rounds]) for key in first}
    return statistics.median(rounds)


def measured(figures: Costs) -> str:
    """Format the measurements as a table."""
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
        ("a step over HTTP: CPU of the server, directly", f"{figures.http_direct.cpu_us:.0f} us"),
        ("a step over HTTP: CPU of the server, through nginx", f"{figures.http_proxied.cpu_us:.0f} us"),
        ("a step over HTTP: CPU of nginx", f"{figures.http_proxied.proxy_us:.0f} us"),
        (
            "a step over HTTP: bytes sent, answered",
            f"{figures.http_proxied.sent:.0f}, {figures.http_proxied.received:.0f}",
        ),
        ("a step over WebSocket: CPU of the server, through nginx", f"{wires.cpu_us:.0f} us"),
        ("a step over WebSocket: CPU of nginx", f"{wires.proxy_us:.0f} us"),
        ("a step over WebSocket: bytes sent, answered", f"{wires.sent:.0f}, {wires.received:.0f}"),
        ("a step kept in the store: CPU", f"{store.step_us:.0f} us"),
        ("a step kept in the store: bytes of SQLite's log", f"{store.log_bytes:.0f}"),
        *[(f"steps kept per second, {n} processes", f"{rate:.0f}") for n, rate in store.steps_per_second.items()],
        *[(f"looking for idle sessions among {n:,}", f"{taken:.1f} ms") for n, taken in store.sweep_ms.items()],
        *[(f"counting {n:,} sessions for a new one", f"{taken:.2f} ms") for n, taken in store.count_ms.items()],
    ]
    return "\n".join(["| what | measured |", "|---|---|", *[f"| {name} | {value} |" for name, value in rows]])


def extrapolated(figures: Costs, rate: float) -> str:
    """Extrapolate the cost of a million sessions."""
    store, http, ws = figures.store, figures.http_proxied, figures.socket_proxied
    steps = MILLION * rate
    written = max(store.steps_per_second.values())

    def cores(wire: Figures) -> tuple[float, float]:
        return steps * wire.cpu_us / 1e6, steps * wire.proxy_us / 1e6

    def gigabits(wire: Figures) -> float:
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
    rounds: list[Costs] = []
    loads = [os.getloadavg()[0]]
    for number in range(given.rounds):
        print(f"round {number + 1} of {given.rounds}", file=sys.stderr, flush=True)
        rounds.append(one_round(given.task, given.sessions, given.seconds))
        loads.append(os.getloadavg()[0])
    figures: Costs = median_of(rounds)
    print(f"Task {given.task}, {given.sessions} sessions, median of {given.rounds} rounds, {os.cpu_count()} cores,")
    print(f"load of the machine {min(loads):.1f} to {max(loads):.1f} (this run included).\n")
    print(measured(figures), "\n", extrapolated(figures, given.rate), sep="\n")
    if given.json is not None:
        text = json.dumps({"load": loads, "rounds": rounds}, indent=2)
        given.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
