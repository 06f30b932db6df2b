"""The engine `ray`: run `run_episodes(key)` as tasks on nodes that equal the driver."""

import dataclasses
import hashlib
import platform
import socket
import tempfile
from collections.abc import Iterator, Sequence
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, cast

import numpy as np
import ray
from ray.exceptions import RayError, RayTaskError

from drone_env import __version__
from drone_env.agents import file_of, rebase_agent_path
from drone_env.envs.registry import load_plugins, plugin_names
from drone_env.errors import ClusterError, DroneEnvError, InvalidValueError
from drone_env.results.evaluate import run_episodes
from drone_env.results.result import EpisodesKey, Results

RETRIES = 10
"""Maximum number of retries of a chunk whose node dies."""
AHEAD = 2
"""Submitted chunks per CPU, so that no CPU waits for the driver."""


def fly_on_nodes(keys: Sequence[EpisodesKey]) -> Iterator[Results]:
    """Yield the results of all keys in order of arrival. Use it inside `connect`.

    A file in an agent's name is sent to the nodes. Your own modules must exist on every node.

    Raises:
        ClusterError: if no node offers a CPU, a node has another version of this package or fails, or a chunk is lost
            on every try.
        DroneEnvError: if `run_episodes` raises it.
    """
    cluster: Any = ray
    if not cluster.cluster_resources().get("CPU"):
        raise ClusterError("no node of the cluster offers a CPU")
    files = {key.agent: file_of(key.agent) for key in keys}
    contents = {agent: cluster.put(file.read_bytes()) for agent, file in files.items() if file is not None}
    fly = cluster.remote(num_cpus=1, max_retries=RETRIES)(_fly)
    plugins, remaining = plugin_names(), iter(keys)
    identity = node_identity(plugins)
    pending: dict[Any, EpisodesKey] = {}
    while True:
        room = AHEAD * max(1, int(cluster.cluster_resources().get("CPU", 1))) - len(pending)
        for key in islice(remaining, max(0, room)):
            pending[fly.remote(identity, plugins, key, contents.get(key.agent))] = key
        if not pending:
            return
        for task in cluster.wait(list(pending))[0]:
            key = pending.pop(task)
            try:
                results = cluster.get(task)
            except RayTaskError as error:
                ours = isinstance(error.cause, (DroneEnvError, OSError))
                raise error.cause if ours else ClusterError(f"a node failed: {error}") from None
            except RayError as error:
                raise ClusterError(f"a chunk was lost, flown {1 + RETRIES} times: {error}") from None
            yield dataclasses.replace(results, key=key)


def _fly(identity: str, plugins: tuple[str, ...], key: EpisodesKey, content: bytes | None) -> Results:
    check_node(identity, plugins)
    if content is None:
        return run_episodes(key)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"file{cast(Path, file_of(key.agent)).suffix}"
        file.write_bytes(content)
        return run_episodes(key._replace(agent=rebase_agent_path(key.agent, file)))


def check_node(identity: str, plugins: tuple[str, ...]) -> None:
    """Import the driver's plugins on a node, and check that the node equals the driver.

    Raises:
        ClusterError: if its package or a plugin differs, or a plugin is missing.
    """
    here = socket.gethostname()
    try:
        mine = node_identity(plugins)
    except InvalidValueError as error:
        raise ClusterError(f"node {here} lacks a plugin of the driver: {error}") from None
    if mine != identity:
        raise ClusterError(f"node {here} has {mine}, the driver has {identity}: make them equal")


@lru_cache(maxsize=1)
def node_identity(plugins: tuple[str, ...]) -> str:
    """Return the versions of this process, and a digest of the files of this package and of the plugins."""
    package, digest = Path(__file__).parents[1], hashlib.sha256()
    files = [file for file in sorted(package.rglob("*")) if file.suffix in (".py", ".safetensors", ".toml")]
    for file in [*files, *(Path(module.__file__) for module in load_plugins(plugins) if module.__file__)]:
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    minor, named = ".".join(platform.python_version_tuple()[:2]), "".join(f", {name}" for name in plugins)
    return f"drone-env {__version__} ({digest.hexdigest()[:16]}{named}), NumPy {np.__version__}, Python {minor}"
