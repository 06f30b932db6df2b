"""The one place where Ray is started or joined: always with a token, never with usage statistics."""

import logging
import os
import secrets
import socket
from collections.abc import Generator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any

from drone_env.errors import ClusterError, InvalidValueError, needs

LOCAL, AUTO = "local", "auto"
CONNECT_SECONDS = 10


@contextmanager
def connect(address: str | None = None, cpus: int | None = None) -> Generator[None, None, None]:
    """Ray, from here to the end of the `with`.

    Token authentication is on unless RAY_AUTH_MODE says `disabled`. A cluster that is started here has the token that
    RAY_AUTH_TOKEN, RAY_AUTH_TOKEN_PATH or ~/.ray/auth_token names, else one of this process alone; it ends with the
    `with`.

    Args:
        address: `local` or None starts a cluster of this machine alone, `auto` joins the one that runs here or at
            RAY_ADDRESS, HOST:PORT joins that one.
        cpus: Of a cluster that is started here; the machine's if nothing is said.

    Raises:
        MissingPackageError: if Ray is not installed.
        InvalidValueError: if this process is connected already, or the address has another form.
        ClusterError: if there is no cluster at the address, it refuses the token, or none can be started.
    """
    address = LOCAL if address is None else address
    # Read by Ray when it is imported, and handed on to all processes that it starts.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_AUTH_MODE", "token")
    # How Ray will behave in future; it warns of it otherwise.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    if address == LOCAL and not _has_token():
        # Ray keeps the first token that it has read as long as the process lives.
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
    with needs("cluster"):
        import ray
        from ray.exceptions import AuthenticationError
    if ray.is_initialized():
        raise InvalidValueError("this process is connected to a cluster already")
    _news_to_standard_error()
    if address not in (LOCAL, AUTO):
        _check_reachable(address)
    own: dict[str, Any] = {"num_cpus": cpus, "include_dashboard": False} if address == LOCAL else {}
    try:
        ray.init(address, log_to_driver=False, logging_level=logging.WARNING, **own)
    except AuthenticationError as error:
        wanted = "set RAY_AUTH_TOKEN or RAY_AUTH_TOKEN_PATH to its token"
        raise ClusterError(f"the cluster at {address} refuses: {wanted} ({error.message})") from None
    except Exception as error:  # all that Ray raises if its processes do not start in time
        raise ClusterError(
            f"cannot join the cluster at {address}: it does not answer, or has another token than RAY_AUTH_TOKEN or "
            f"RAY_AUTH_TOKEN_PATH: {error}"
        ) from None
    try:
        yield
    finally:
        ray.shutdown()


@lru_cache(maxsize=1)
def _news_to_standard_error() -> None:
    """Ray prints on standard output that a node has died, in the middle of results; there is no setting for it."""
    import ray._private.worker as ray_worker

    worker: Any = ray_worker
    printed = worker.print_to_stdstream

    def to_standard_error(data: dict[str, Any], *arguments: Any, **more: Any) -> None:
        printed({**data, "is_err": True}, *arguments, **more)

    worker.print_to_stdstream = to_standard_error


def _check_reachable(address: str) -> None:
    """Ray itself would try for minutes where nobody listens."""
    host, _, port = address.rpartition(":")
    if not host or "/" in host or not port.isdecimal():
        raise InvalidValueError(f"--address takes local, auto or HOST:PORT, got {address!r}")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=CONNECT_SECONDS).close()
    except (OSError, OverflowError) as error:
        raise ClusterError(f"there is no cluster to be reached at {address}: {error}") from None


def _has_token() -> bool:
    named = any(os.environ.get(name) for name in ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"))
    return named or (Path.home() / ".ray" / "auth_token").is_file()
