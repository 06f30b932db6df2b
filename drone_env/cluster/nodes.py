"""The nodes of a cluster: they must have the sources, plugins, NumPy and Python of the driver."""

import hashlib
import platform
import socket
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np

from drone_env import __version__
from drone_env.envs.registry import load_plugins, plugin_names
from drone_env.errors import ClusterError, DroneEnvError, InvalidValueError


@dataclass(frozen=True)
class Driver:
    """The identity of the driver, which every node must share."""

    identity: str
    plugins: tuple[str, ...]
    """Modules that register tasks and reward profiles."""


def this_driver() -> Driver:
    """The identity of this process.

    Raises:
        InvalidValueError: if a module that `DRONE_ENV_PLUGINS` names does not exist.
    """
    plugins = plugin_names()
    return Driver(_identity(plugins), plugins)


@lru_cache(maxsize=1)
def _identity(plugins: tuple[str, ...]) -> str:
    """Versions, and digests of the files of this package and of the plugins."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*")):
        if file.suffix in (".py", ".safetensors", ".toml"):
            digest.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    minor = ".".join(platform.python_version_tuple()[:2])
    own = f"drone-env {__version__} ({digest.hexdigest()[:16]}), NumPy {np.__version__}, Python {minor}"
    return ", ".join([own, *map(_plugin, load_plugins(plugins))])


def _plugin(module: ModuleType) -> str:
    content = Path(module.__file__).read_bytes() if module.__file__ else b""
    return f"{module.__name__} ({hashlib.sha256(content).hexdigest()[:16]})"


def check_node(driver: Driver) -> None:
    """Import the driver's plugins on a node, and check that the node equals the driver.

    Raises:
        ClusterError: if its package or a plugin differs, or a plugin is missing.
    """
    here = socket.gethostname()
    try:
        mine = _identity(driver.plugins)
    except InvalidValueError as error:
        raise ClusterError(f"node {here} lacks a plugin of the driver: {error}") from None
    if mine != driver.identity:
        raise ClusterError(f"node {here} has {mine}, the driver has {driver.identity}: make them equal")


def nodes_with_cpus() -> list[str]:
    """The ids of the nodes that offer CPUs. Use it inside `connect`."""
    import ray

    nodes = cast(list[dict[str, Any]], cast(Any, ray).nodes())
    return [node["NodeID"] for node in nodes if node["Alive"] and node["Resources"].get("CPU")]


def failure(error: Any) -> Exception:
    """The cause of a `RayTaskError` if it is a `DroneEnvError` or an `OSError`; else a `ClusterError`."""
    cause: Any = error.cause
    return cause if isinstance(cause, (DroneEnvError, OSError)) else ClusterError(f"a node failed: {error}")
