"""Evaluate on a Ray cluster: `run_episodes(key)` as tasks on nodes that equal the driver."""

import logging
import os
import platform
import secrets
import socket
import sys
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from itertools import islice
from typing import Any

import numpy as np

from drone_env import __version__
from drone_env.envs.registry import load_plugins, plugin_names
from drone_env.errors import ClusterError, DroneEnvError, InvalidValueError, needs
from drone_env.results.evaluate import run_episodes
from drone_env.results.result import EpisodesKey, Results

RETRIES = 10
"""Maximum number of retries of a chunk whose node dies."""
AHEAD = 2
"""Submitted chunks per CPU, so that no CPU waits for the driver."""
VERSIONS = f"drone-env {__version__}, NumPy {np.__version__}, Python {platform.python_version().rpartition('.')[0]}"
"""What driver and nodes must have in common."""


@contextmanager
def connect(address: str = "local") -> Generator[Any, None, None]:
    """Connect to Ray until the end of the `with`, and yield its module.

    Token authentication is on unless RAY_AUTH_MODE is `disabled`. A cluster that starts here uses the token from
    RAY_AUTH_TOKEN, else a random one, and ends with the `with`. Ray's messages go to standard error.

    Args:
        address: `local` starts a cluster on this machine, `auto` joins the one that runs here or at RAY_ADDRESS,
            HOST:PORT joins that one.

    Raises:
        MissingPackageError: if Ray is not installed.
        ClusterError: if there is no cluster at the address, it refuses the token, or none can be started.
    """
    # Ray reads these variables when it is imported, and passes them to its processes.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_AUTH_MODE", "token")
    # The future default; without it Ray prints a warning.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    if address == "local":
        os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
    elif address != "auto":
        _check_reachable(address)
    with needs("cluster"):
        import ray
    with redirect_stdout(sys.stderr):
        try:
            dashboard = False if address == "local" else None
            ray.init(address, include_dashboard=dashboard, log_to_driver=False, logging_level=logging.WARNING)
        except Exception as error:  # Ray raises many types if its processes do not start in time.
            raise ClusterError(
                f"cannot join the cluster at {address}: {error}. Does it respond, and is its token that of "
                "RAY_AUTH_TOKEN or RAY_AUTH_TOKEN_PATH?"
            ) from None
        try:
            yield ray
        finally:
            ray.shutdown()


def _check_reachable(address: str) -> None:
    """Fail within seconds if nothing listens at the address; Ray would retry for minutes."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=10).close()
    except (OSError, OverflowError, ValueError) as error:
        raise ClusterError(f"no cluster at {address!r}; --ray takes local, auto or HOST:PORT: {error}") from None


def fly_on_nodes(keys: Sequence[EpisodesKey], address: str = "local") -> Iterator[Results]:
    """Yield the results of all keys in order of arrival.

    A file in an agent's name and your own modules must exist on every node.

    Raises:
        MissingPackageError, ClusterError: from `connect`; also if no node offers a CPU, a node has other versions or
            fails, or a chunk is lost on every try.
        DroneEnvError: if `run_episodes` raises it.
    """
    with connect(address) as ray:
        if not ray.cluster_resources().get("CPU"):
            raise ClusterError("no node of the cluster offers a CPU")
        fly = ray.remote(num_cpus=1, max_retries=RETRIES)(_fly)
        remaining = iter(keys)
        pending: set[Any] = set()
        while True:
            room = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1))) - len(pending)
            for key in islice(remaining, max(0, room)):
                pending.add(fly.remote(VERSIONS, plugin_names(), key))
            if not pending:
                return
            for task in ray.wait(list(pending))[0]:
                pending.remove(task)
                try:
                    results = ray.get(task)
                except ray.exceptions.RayTaskError as error:
                    ours = isinstance(error.cause, (DroneEnvError, OSError))
                    raise error.cause if ours else ClusterError(f"a node failed: {error}") from None
                except ray.exceptions.RayError as error:
                    raise ClusterError(f"a chunk was lost, flown {1 + RETRIES} times: {error}") from None
                yield results


def _fly(versions: str, plugins: tuple[str, ...], key: EpisodesKey) -> Results:
    check_node(versions, plugins)
    return run_episodes(key)


def check_node(versions: str, plugins: tuple[str, ...]) -> None:
    """Import the driver's plugins on a node, and check that the node equals the driver.

    Raises:
        ClusterError: if its versions differ, or a plugin is missing.
    """
    here = socket.gethostname()
    if versions != VERSIONS:
        raise ClusterError(f"node {here} has {VERSIONS}, the driver has {versions}: make them equal")
    try:
        load_plugins(plugins)
    except InvalidValueError as error:
        raise ClusterError(f"node {here} lacks a plugin of the driver: {error}") from None
