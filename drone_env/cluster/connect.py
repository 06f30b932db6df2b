"""Start or join Ray, always with a token and never with usage statistics."""

import logging
import os
import secrets
import socket
from collections.abc import Generator
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

from drone_env.errors import ClusterError, InvalidValueError, needs


@contextmanager
def connect(address: str | None = None) -> Generator[None, None, None]:
    """Connect to Ray until the end of the `with`.

    Token authentication is on unless RAY_AUTH_MODE is `disabled`. A cluster that starts here uses the token from
    RAY_AUTH_TOKEN, RAY_AUTH_TOKEN_PATH or ~/.ray/auth_token, else a random one, and ends with the `with`.

    Args:
        address: `local` or None starts a cluster on this machine, `auto` joins the one that runs here or at
            RAY_ADDRESS, HOST:PORT joins that one.

    Raises:
        MissingPackageError: if Ray is not installed.
        InvalidValueError: if the address is malformed.
        ClusterError: if there is no cluster at the address, it refuses the token, or none can be started.
    """
    address = "local" if address is None else address
    # Ray reads these variables when it is imported, and passes them to its processes.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_AUTH_MODE", "token")
    # The future default; without it Ray prints a warning.
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    named = os.environ.get("RAY_AUTH_TOKEN") or os.environ.get("RAY_AUTH_TOKEN_PATH")
    if address == "local" and not named and not (Path.home() / ".ray" / "auth_token").is_file():
        # Ray caches the first token that it reads for the lifetime of the process.
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
    with needs("cluster"):
        import ray
    _redirect_messages()
    if address not in ("local", "auto"):
        _check_reachable(address)
    dashboard = False if address == "local" else None
    try:
        ray.init(address, include_dashboard=dashboard, log_to_driver=False, logging_level=logging.WARNING)
    except Exception as error:  # Ray raises many types if its processes do not start in time.
        raise ClusterError(
            f"cannot join the cluster at {address}: {error}. Does it respond, and is its token that of RAY_AUTH_TOKEN "
            "or RAY_AUTH_TOKEN_PATH?"
        ) from None
    try:
        yield
    finally:
        ray.shutdown()


@lru_cache(maxsize=1)
def _redirect_messages() -> None:
    """Redirect messages such as the death of a node, which Ray prints among the results, to standard error."""
    worker: Any = import_module("ray._private.worker")
    printed = worker.print_to_stdstream

    def to_standard_error(data: dict[str, Any], *arguments: Any, **more: Any) -> None:
        printed({**data, "is_err": True}, *arguments, **more)

    worker.print_to_stdstream = to_standard_error


def _check_reachable(address: str) -> None:
    """Fail within seconds if nothing listens at the address; Ray would retry for minutes."""
    host, _, port = address.rpartition(":")
    if not host or "/" in host or not port.isdecimal():
        raise InvalidValueError(f"--address takes local, auto or HOST:PORT, got {address!r}")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=10).close()
    except (OSError, OverflowError) as error:
        raise ClusterError(f"no cluster is reachable at {address}: {error}") from None
