"""A Ray cluster of several nodes on this machine."""

import contextlib
import os
import secrets
from collections.abc import Generator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from tests.tools import eventually

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


@pytest.fixture(scope="session")
def cluster() -> Generator[Any, None, None]:
    """A head without CPUs and two nodes with one each; a test that kills one puts another in its place."""
    with patch.dict(os.environ, STARTING):
        from ray.cluster_utils import Cluster

        started = Cluster()
        try:
            started.add_node(num_cpus=0, include_dashboard=False, object_store_memory=MEMORY)
            for _ in range(2):
                started.add_node(num_cpus=1, object_store_memory=MEMORY)
            yield started
        finally:
            started.shutdown()
            eventually(lambda: not _is_running())


def _is_running() -> bool:
    """Whether a process that was started with the cluster's token has not ended."""
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            if TOKEN.encode() in environment.read_bytes():
                return True
    return False
