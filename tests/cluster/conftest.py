"""A Ray cluster of several nodes on this machine."""

import contextlib
import os
import secrets
import signal
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

MEMORY = 80 * 2**20
TOKEN = secrets.token_hex(32)
# Ray reads these when it is imported, which happens when the tests are collected.
os.environ.update({"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": TOKEN})
STARTING = {
    "RAY_USAGE_STATS_ENABLED": "0",
    # Ray's own is 15: on a machine that has other things to do its workers would hardly start.
    "RAY_worker_niceness": "0",
    # Nodes import functions of the tests, wherever the tests run.
    "PYTHONPATH": str(Path(__file__).parents[2]),
}
ENDING_SECONDS = 60.0


@pytest.fixture(scope="session")
def cluster() -> Generator[Any, None, None]:
    """A head without CPUs and two nodes with one each; a test that kills one puts another in its place."""
    before = dict(os.environ)
    os.environ.update(STARTING)
    from ray.cluster_utils import Cluster

    started = Cluster()
    try:
        started.add_node(num_cpus=0, include_dashboard=False, object_store_memory=MEMORY)
        for _ in range(2):
            started.add_node(num_cpus=1, object_store_memory=MEMORY)
        yield started
    finally:
        started.shutdown()
        until = time.monotonic() + ENDING_SECONDS
        while (left := _processes()) and time.monotonic() < until:
            time.sleep(0.1)
        for process in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        os.environ.clear()
        os.environ.update(before)


def _processes() -> list[int]:
    """All processes that were started with the cluster's token and have not ended."""
    found: list[int] = []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if TOKEN.encode() in (folder / "environ").read_bytes():
                found.append(int(folder.name))
    return found


@contextmanager
def node_killed_when(cluster: Any, holds: Callable[[], bool]) -> Generator[None, None, None]:
    """Kill a node as soon as something holds, which has to be inside of the block; then put another in its place."""
    over = threading.Event()
    killed: list[Any] = []

    def kill() -> None:
        while not over.wait(0.01):
            if holds():
                killed.append(next(iter(cluster.worker_nodes)))
                cluster.remove_node(killed[0], allow_graceful=False)
                return

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    try:
        yield
    finally:
        over.set()
        killer.join(120)
        if killed:
            cluster.add_node(num_cpus=1, object_store_memory=MEMORY)
    assert killed, "all was done before a node could be killed"
