"""The origin of a request: loopback names, and the address whose callers share a session."""

import ipaddress
from functools import lru_cache
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import Scope

PROXY_HEADERS, FORWARDED = ("forwarded", "via", "x-real-ip"), "x-forwarded-"
BROWSER_HEADERS = ("origin", "sec-fetch-site")


@lru_cache(maxsize=1024)
def is_local_name(host: str) -> bool:
    """Whether a host name or an address, in lower case, always means the loopback interface."""
    name = host.rstrip(".")
    if name == "localhost" or name.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def listens_on_loopback(scope: Scope, host: str) -> bool:
    """Whether only programs on this machine can reach the server, as far as a request shows.

    A request that arrives at another address proves the opposite. One that arrives at loopback does not prove it: a
    server on all addresses gets it as well.

    Args:
        scope: The request; `server` is the local end of its connection.
        host: The configured address. uvicorn started by hand may listen elsewhere.
    """
    server = scope.get("server")
    return server is not None and is_local_name(server[0].lower()) and not _is_wildcard(host)


def shared_address(scope: Scope) -> str | None:
    """The address whose callers share a session; None for browsers, and for requests through a proxy.

    Browsers keep cookies. A proxy brings many callers under one address.
    """
    client = scope.get("client")
    if client is None or _comes_through_proxy(scope) or any(name in BROWSER_HEADERS for name in Headers(scope=scope)):
        return None
    return client[0]


def stranger_address(scope: Scope, host: str) -> str | None:
    """The address of a caller of a server that strangers reach; None if nobody but this machine reaches it.

    A proxy may bring strangers. For IPv6 it is the network of 64 bits: whoever has one of its addresses has them all.
    """
    client = (scope.get("client") or ("unknown",))[0].lower()
    if not _comes_through_proxy(scope) and is_local_name(client) and listens_on_loopback(scope, host):
        return None
    try:
        address = ipaddress.ip_address(client)
    except ValueError:
        return client
    if isinstance(address, ipaddress.IPv4Address):
        return client
    mapped = address.ipv4_mapped
    return str(ipaddress.ip_network((address, 64), strict=False)) if mapped is None else str(mapped)


def _comes_through_proxy(scope: Scope) -> bool:
    """Whether a request shows a proxy: proxies that add no header speak HTTP/1.0."""
    names = Headers(scope=scope).keys()
    added = any(name in PROXY_HEADERS or name.startswith(FORWARDED) for name in names)
    return added or scope.get("http_version") == "1.0"


@lru_cache(maxsize=1024)
def host_name(header: str) -> str:
    """The name in a `Host` header, without port, in lower case."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


@lru_cache
def _is_wildcard(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_unspecified
    except ValueError:
        return False
