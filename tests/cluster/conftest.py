"""A Ray cluster of several nodes on this machine, and scripted endpoints."""

import os
import secrets
from collections.abc import Generator
from typing import Any

import pytest

from tests.llm.conftest import endpoint, scripted_server

__all__ = ["endpoint", "scripted_server"]

MEMORY = 80 * 2**20
STARTING = {
    "RAY_AUTH_MODE": "token",
    "RAY_AUTH_TOKEN": secrets.token_hex(32),
    "RAY_USAGE_STATS_ENABLED": "0",
    # Ray's own is 15: on a machine that has other things to do its workers would hardly start.
    "RAY_worker_niceness": "0",
}


@pytest.fixture(scope="session")
def cluster() -> Generator[Any, None, None]:
    """A head without CPUs and two nodes with one each; a test that kills one puts another in its place."""
    before = {name: os.environ.get(name) for name in STARTING}
    os.environ.update(STARTING)
    from ray.cluster_utils import Cluster

    started = Cluster(
        initialize_head=True,
        head_node_args={"num_cpus": 0, "include_dashboard": False, "object_store_memory": MEMORY},
    )
    for _ in range(2):
        started.add_node(num_cpus=1, object_store_memory=MEMORY)
    yield started
    started.shutdown()
    for name, value in before.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
