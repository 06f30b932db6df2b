"""The address of a request that names no session."""

from starlette.datastructures import Headers
from starlette.types import Scope

PROXY_HEADERS, FORWARDED = ("forwarded", "via", "x-real-ip"), "x-forwarded-"
BROWSER_HEADERS = ("origin", "sec-fetch-site")


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
