"""The origin of a request: this machine, another, or a proxy."""

import ipaddress
from functools import lru_cache
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import Scope

PROXY_HEADERS, FORWARDED = ("forwarded", "via", "x-real-ip"), "x-forwarded-"
BROWSER_HEADERS = ("origin", "sec-fetch-site")
EVERYWHERE = ("0.0.0.0", "::")


@lru_cache(maxsize=1024)
def is_local_name(host: str) -> bool:
    """Return whether a lower-case host name or address always means the loopback interface."""
    name = host.rstrip(".")
    if name == "localhost" or name.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@lru_cache(maxsize=1024)
def listens_on_loopback(local: str, host: str) -> bool:
    """Return whether only programs on this machine can reach the server.

    A request that arrives at loopback does not prove it, because a server on all addresses receives it as well.

    Args:
        local: The local end of its connection.
        host: The configured address; uvicorn started by hand may use another.
    """
    return is_local_name(local.lower()) and host not in EVERYWHERE


def shared_address(scope: Scope) -> str | None:
    """Return the address whose callers share a session.

    None for browsers, which keep cookies, and for proxies, which have many callers under one address.
    """
    client = scope.get("client")
    if client is None or _comes_through_proxy(scope) or any(name in BROWSER_HEADERS for name in Headers(scope=scope)):
        return None
    return client[0]


def _comes_through_proxy(scope: Scope) -> bool:
    """Return whether a request came through a proxy. Proxies that add no header use HTTP/1.0."""
    names = Headers(scope=scope).keys()
    added = any(name in PROXY_HEADERS or name.startswith(FORWARDED) for name in names)
    return added or scope.get("http_version") == "1.0"


@lru_cache(maxsize=1024)
def host_name(header: str) -> str:
    """Return the lower-case name in a `Host` header, without port."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""
