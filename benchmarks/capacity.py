"""Measure memory and disk of a session, and CPU time of a step through nginx, for one server process.

    python benchmarks/capacity.py [--task hard] [--sessions 1000] [--rounds 3] [--seconds 3]

The table shows medians of the rounds. nginx is configured by `deploy/nginx.conf`. Linux only.
"""

import argparse
import asyncio
import json
import os
import statistics
import sys
import tempfile
from collections.abc import Generator, Iterable
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.server import MOVES, NEW, Http, Session, open_session, time_sessions
from tests.api.serving import serving
from tests.cluster.serving import COMMAND, Nginx

STEPS = 20
"""Steps of each session before its memory is measured."""
BUSY = 16
"""Sessions that step at the same time while CPU time is measured."""


class Served(NamedTuple):
    """A server and nginx before it: their ports and process ids, and the data folder."""

    port: int
    proxy: int
    server_ids: list[int]
    proxy_ids: list[int]
    data: Path


@contextmanager
def served(folder: Path, sessions: int) -> Generator[Served, None, None]:
    """Context manager of a server with room for this many sessions, and nginx before it."""
    folder.mkdir()
    # One address may have half of the sessions.
    settings = {"CAPACITY": str(2 * sessions + 200), "IDLE_SECONDS": "86400"}
    with ExitStack() as started:
        server = started.enter_context(serving(folder / "data", tuple(COMMAND), None, **settings))
        nginx = started.enter_context(closing(Nginx(folder, [port_of(server.url)])))
        server_ids, proxy_ids = family(server.process.pid), family(nginx.process.pid)
        yield Served(port_of(server.url), port_of(nginx.url), server_ids, proxy_ids, server.data)


def port_of(url: str) -> int:
    """The port of a URL."""
    return int(url.rpartition(":")[2])


def family(process: int) -> list[int]:
    """A process and its children."""
    return [process, *map(int, Path(f"/proc/{process}/task/{process}/children").read_text(encoding="utf-8").split())]


def memory_of(processes: Iterable[int]) -> int:
    """Private memory of processes in bytes."""
    texts = [Path(f"/proc/{process}/smaps_rollup").read_text(encoding="utf-8") for process in processes]
    lines = [line for text in texts for line in text.splitlines() if line.startswith("Private_")]
    return 1024 * sum(int(line.split()[1]) for line in lines)


def disk_of(folder: Path) -> int:
    """Size of the files in a folder in bytes."""
    return sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())


async def open_http(port: int, task: str, count: int) -> None:
    """Open HTTP sessions over one connection and fly `STEPS` steps in each."""
    http = Http(port)
    await http.open()
    for seed in range(count):
        opened = json.loads(await http.ask(http.request("/reset", {"task_name": task, "seed": seed}, NEW)))
        named = {"X-Session-Id": opened["session_id"]}
        for step in range(STEPS):
            await http.ask(http.request("/step", {"direction": MOVES[step % 4]}, named))
    await http.close()


async def measure_http(at: Served, task: str, sessions: int, seconds: float) -> dict[str, float]:
    """Memory of a session, and the cost of a step."""
    await open_http(at.port, task, 20)  # allocates memory that all sessions share
    memory = memory_of(at.server_ids)
    await open_http(at.port, task, sessions)
    session = (memory_of(at.server_ids) - memory) / sessions
    busy = [await open_session(at.proxy, "HTTP", task) for _ in range(BUSY)]
    step = await time_sessions(busy, at.server_ids, seconds, at.proxy_ids)
    return {
        "a server without sessions, MB": memory / 1e6,
        "an HTTP session in memory, KB": session / 1e3,
        "a step over HTTP: CPU of server, us": step.cpu_us,
        "a step over HTTP: CPU of nginx, us": step.proxy_us,
        "a step over HTTP: response, KB": step.received / 1e3,
    }


async def first_steps(session: Session) -> None:
    """Fly `STEPS` steps."""
    for step in range(STEPS):
        await session.connection.ask(session.steps[step % 4])


async def measure_sockets(at: Served, task: str, sessions: int, seconds: float) -> dict[str, float]:
    """Memory of a WebSocket, and the cost of a step."""
    for session in [await open_session(at.proxy, "WebSocket", task) for _ in range(8)]:
        await session.connection.close()
    memory, proxy_memory = memory_of(at.server_ids), memory_of(at.proxy_ids)
    opened = [await open_session(at.proxy, "WebSocket", task) for _ in range(sessions)]
    await asyncio.gather(*map(first_steps, opened))
    taken = memory_of(at.server_ids) - memory, memory_of(at.proxy_ids) - proxy_memory
    step = await time_sessions(opened[:BUSY], at.server_ids, seconds, at.proxy_ids)
    for session in opened[BUSY:]:
        await session.connection.close()
    return {
        "a WebSocket in the server, KB": taken[0] / sessions / 1e3,
        "a WebSocket in nginx, KB": taken[1] / sessions / 1e3,
        "a step over WebSocket: CPU of server, us": step.cpu_us,
        "a step over WebSocket: CPU of nginx, us": step.proxy_us,
        "a step over WebSocket: response, KB": step.received / 1e3,
    }


def one_round(task: str, sessions: int, seconds: float) -> dict[str, float]:
    """Measure everything once."""
    with tempfile.TemporaryDirectory() as folder:
        with served(Path(folder, "http"), sessions) as at:
            empty = disk_of(at.data)
            figures = asyncio.run(measure_http(at, task, sessions, seconds))
        # The server merges the write-ahead log into the file at its end.
        figures["an HTTP session on disk, bytes"] = (disk_of(at.data) - empty) / (sessions + 20 + BUSY)
        with served(Path(folder, "sockets"), sessions) as at:
            return figures | asyncio.run(measure_sockets(at, task, sessions, seconds))


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--task", default="hard")
    parser.add_argument("--sessions", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    rounds = [one_round(given.task, given.sessions, given.seconds) for _ in range(given.rounds)]
    print(f"Load of the machine: {os.getloadavg()[0]:.1f}\n\n| what | measured |\n|---|---|")
    for name in rounds[0]:
        print(f"| {name} | {statistics.median(figures[name] for figures in rounds):.1f} |")


if __name__ == "__main__":
    main()
