"""What comes from this machine: who reaches the server, and by which name."""

import ipaddress
import os
import socket
import stat
from contextlib import suppress
from functools import lru_cache
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import Scope

PROXY_HEADERS, FORWARDED = ("forwarded", "via", "x-real-ip"), "x-forwarded-"
BROWSER_HEADERS = ("origin", "sec-fetch-site")
OPEN_SOCKETS = "/dev/fd"


@lru_cache(maxsize=1024)
def is_local_name(host: str) -> bool:
    """Whether a host name or an address, in lower case, is this machine's loopback wherever it is looked up."""
    name = host.rstrip(".")
    if name == "localhost" or name.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def listens_on_loopback(scope: Scope, host: str) -> bool:
    """Whether nobody but this machine reaches the server that got a request.

    Args:
        scope: Of the request. Its `server` is the connection's end here: 127.0.0.1 also where a server that listens
            on all addresses is called from this machine. So the sockets that listen are asked.
        host: Where the settings have it listen; holds where no socket can be asked, as on Windows.
    """
    server = scope.get("server")
    if server is None or not is_local_name(server[0].lower()):
        return False
    listening = _listening(server[1])
    return all(map(is_local_name, listening)) if listening else is_local_name(host.lower())


def local_address(scope: Scope, host: str) -> str | None:
    """The address of a program on this machine that calls a server which nobody else reaches; None for all others.

    Browsers are none.
    """
    client, headers = scope.get("client"), Headers(scope=scope)
    if client is None or any(name in BROWSER_HEADERS for name in headers):
        return None
    named = is_local_name(host_name(headers.get("host", "")))
    return client[0] if named and stranger_address(scope, host) is None else None


def stranger_address(scope: Scope, host: str) -> str | None:
    """The address of a caller of a server that strangers reach; None if nobody but this machine reaches it.

    A proxy may bring strangers. HTTP/1.0 is what proxies speak that add no header. Of IPv6 the network of 64 bits
    counts: whoever has one address has them all.
    """
    client = (scope.get("client") or ("unknown",))[0].lower()
    headers = Headers(scope=scope)
    proxied = any(name in PROXY_HEADERS or name.startswith(FORWARDED) for name in headers)
    direct = scope.get("http_version") != "1.0" and not proxied
    if direct and is_local_name(client) and listens_on_loopback(scope, host):
        return None
    try:
        address = ipaddress.ip_address(client)
    except ValueError:
        return client
    if isinstance(address, ipaddress.IPv4Address):
        return client
    mapped = address.ipv4_mapped
    return str(ipaddress.ip_network((address, 64), strict=False)) if mapped is None else str(mapped)


@lru_cache(maxsize=1024)
def host_name(header: str) -> str:
    """The name in a `Host` header, without port, in lower case."""
    try:
        return urlsplit(f"//{header}").hostname or ""
    except ValueError:
        return ""


@lru_cache(maxsize=16)
def _listening(port: int) -> tuple[str, ...]:
    """The addresses at which this process listens on a port; empty where the system does not say."""
    if not os.path.isdir(OPEN_SOCKETS):
        return ()
    found: list[str] = []
    for number in map(int, os.listdir(OPEN_SOCKETS)):
        with suppress(OSError):  # another thread may close it meanwhile
            if not stat.S_ISSOCK(os.fstat(number).st_mode):
                continue
            with socket.socket(fileno=os.dup(number)) as copy:
                name = copy.getsockname()
                listens = copy.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
                if listens and copy.family in (socket.AF_INET, socket.AF_INET6) and name[1] == port:
                    found.append(name[0])
    return tuple(found)
