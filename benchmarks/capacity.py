"""What a session and a step cost a server, its store and nginx, and what a million sessions would come to.

    python benchmarks/capacity.py [--task hard] [--sessions 1000] [--rounds 3] [--rate 1] [--json FILE]

One server process, nginx as `deploy` configures it, and a store are measured each by itself; shown is the median of the
rounds. CPU time is that of the processes, which other load on the machine changes less than it does the clock. The last
table is an extrapolation: measured figures times sessions, nothing else.
"""

import argparse
import asyncio
import json
import os
import statistics
import sys
import tempfile
from collections.abc import Generator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.session_costs import (  # noqa: E402
    STEPS,
    SocketMemory,
    Wire,
    children,
    episode_bytes,
    files_of,
    memory_of,
    open_rows,
    sockets,
    time_http,
)
from benchmarks.store_costs import StoreFigures, measure_store  # noqa: E402
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


def median_of(rounds: Sequence[Any]) -> Any:
    """The median of every number in named tuples and dictionaries that are built alike."""
    first = rounds[0]
    if hasattr(first, "_make"):
        return first._make([median_of(column) for column in zip(*rounds, strict=True)])
    if hasattr(first, "keys"):
        return {key: median_of([each[key] for each in rounds]) for key in first}
    return statistics.median(rounds)


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
    figures: Figures = median_of(rounds)
    print(f"Task {given.task}, {given.sessions} sessions, median of {given.rounds} rounds, {os.cpu_count()} cores,")
    print(f"load of the machine {min(loads):.1f} to {max(loads):.1f} (this run included).\n")
    print(measured(figures), "\n", extrapolated(figures, given.rate), sep="\n")
    if given.json is not None:
        text = json.dumps({"load": loads, "rounds": rounds}, indent=2)
        given.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
