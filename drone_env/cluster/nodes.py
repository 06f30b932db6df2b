"""Whether nodes can do the work, and the same as the driver: CPUs, equal sources, plugins, NumPy and Python."""

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
from drone_env.errors import ClusterError, InvalidValueError


@dataclass(frozen=True)
class Driver:
    """What every node must have as the driver has it."""

    identity: str
    plugins: str
    """Modules that register tasks and reward profiles, comma-separated."""


def this_driver() -> Driver:
    """What this process has.

    Raises:
        InvalidValueError: if a module that `DRONE_ENV_PLUGINS` names does not exist.
    """
    plugins = plugin_names()
    return Driver(_identity(plugins), plugins)


@lru_cache(maxsize=1)
def _identity(plugins: str) -> str:
    """Versions, and a digest of all that this package ships and of the plugins' files."""
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
    """To be called first on a node: imports the driver's plugins, and compares.

    Raises:
        ClusterError: if its package is not the driver's, or a plugin is missing or another.
    """
    here = socket.gethostname()
    try:
        mine = _identity(driver.plugins)
    except InvalidValueError as error:
        raise ClusterError(f"node {here} lacks a plugin of the driver's: {error}") from None
    if mine != driver.identity:
        raise ClusterError(f"node {here} has {mine}, the driver has {driver.identity}: make them equal")


def check_cpus(needed: int) -> None:
    """To be called by the driver, inside of `connect`: Ray would wait without a word for a node that is large enough.

    Raises:
        ClusterError: if no node offers this many CPUs.
    """
    import ray

    nodes = [node for node in cast(list[dict[str, Any]], cast(Any, ray).nodes()) if node["Alive"]]
    most = int(max((node["Resources"].get("CPU", 0) for node in nodes), default=0))
    if most < needed:
        raise ClusterError(f"no node of the cluster offers {needed} CPUs at once: the most that one has are {most}")
