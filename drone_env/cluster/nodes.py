"""Whether nodes can do the work, and the same as the driver: CPUs, equal sources, equal NumPy, equal Python."""

import hashlib
import platform
import socket
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

import numpy as np

from drone_env import __version__
from drone_env.errors import ClusterError


@lru_cache(maxsize=1)
def identity() -> str:
    """What must be equal everywhere: versions, and a digest of all that this package ships."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*")):
        if file.suffix in (".py", ".npz", ".toml"):
            digest.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    minor = ".".join(platform.python_version_tuple()[:2])
    return f"drone-env {__version__} ({digest.hexdigest()[:16]}), NumPy {np.__version__}, Python {minor}"


def check_identity(of_driver: str) -> None:
    """To be called first on a node.

    Raises:
        ClusterError: if its package is not the driver's.
    """
    if identity() != of_driver:
        raise ClusterError(f"node {socket.gethostname()} has {identity()}, the driver has {of_driver}: make them equal")


def check_cpus(needed: int) -> None:
    """To be called by the driver, inside of `connect`: Ray would wait without a word for a node that is large enough.

    Raises:
        ClusterError: if no node offers so many CPUs.
    """
    import ray

    nodes = [node for node in cast(list[dict[str, Any]], cast(Any, ray).nodes()) if node["Alive"]]
    most = int(max((node["Resources"].get("CPU", 0) for node in nodes), default=0))
    if most < needed:
        raise ClusterError(f"no node of the cluster offers {needed} CPUs at once: the most that one has are {most}")
