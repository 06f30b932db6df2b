"""Who may call, and with what: pure ASGI middlewares.

From the outside in: `SecurityHeaders`, `AllowedCallers`. `incoming.JsonRoute` reads the bodies.
"""

import base64
import binascii
import hmac
import ipaddress
from collections.abc import Collection
from functools import lru_cache
from urllib.parse import urlsplit

from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drone_env.server.page_files import is_file
from drone_env.server.problems import RequestError, answer_to
from drone_env.server.settings import Settings

OPEN_PATHS = {"/health", "/"}
"""Answered without a token, as the files of the page: programs that watch the process have none, and the page asks."""
POLICY_VIOLATION = 1008
OFFER = "bearer."


class SecurityHeaders:
    """Headers that tell browsers what the answers may be used for.

    Args:
        app: The application within.
        frame_ancestors: Who may show the page in a frame.
    """

    def __init__(self, app: ASGIApp, frame_ancestors: Collection[str]) -> None:
        self.app = app
        framing = " ".join(frame_ancestors) or "'none'"
        policy = (
            # 'self' includes WebSockets of the same origin since Chrome 71, Firefox 63 and Safari 16.
            f"default-src 'self'; object-src 'none'; base-uri 'none'; frame-ancestors {framing}; "
            "img-src 'self' data: blob:"
        )
        self.headers = [
            (b"content-security-policy", policy.encode("latin-1")),
            (b"x-content-type-options", b"nosniff"),
            (b"referrer-policy", b"no-referrer"),
            (b"cross-origin-resource-policy", b"same-origin"),
        ]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Add the headers to an HTTP answer."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return

        # Browsers ask whether the page has changed, so that an update of the package is seen at once.
        is_page = scope["path"] in ("/", "/docs") or scope["path"].startswith("/static/")

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = [*message.get("headers", ()), *self.headers]
                if not any(name.lower() == b"cache-control" for name, _ in headers):
                    headers.append((b"cache-control", b"no-cache" if is_page else b"no-store"))
                message["headers"] = headers
            await send(message)

        await self.app(scope, receive, send_with_headers)


class AllowedCallers:
    """Answers what is addressed to the server's hosts, comes from no page of another origin, and carries the token.

    A server on loopback answers for the names of this machine and for `allowed_hosts` only: DNS rebinding would let any
    web page call it. Browsers name the origin of a page in the `Origin` header; programs send none.

    Args:
        app: The application within.
        settings: Which hosts and origins, and the token, if any.
    """

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app = app
        self.hosts = {host.lower() for host in settings.allowed_hosts}
        self.listens = settings.host.lower()
        self.origins = {origin.lower().rstrip("/") for origin in settings.allowed_origins}
        self.expected = None if settings.token is None else settings.token.get_secret_value().encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is allowed; a WebSocket that is not is closed before it opens."""
        try:
            if scope["type"] in ("http", "websocket"):
                self._check(scope, Headers(scope=scope))
        except RequestError as error:
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": POLICY_VIOLATION, "reason": str(error)[:120]})
            else:
                await answer_to(error, scope)(scope, receive, send)
            return
        await self.app(scope, receive, send)

    def _check(self, scope: Scope, headers: Headers) -> None:
        named = headers.get("host", "")
        host = host_name(named)
        if not self._answers(host, scope):
            detail = f"this server does not answer for host {host!r}; DRONE_ENV_ALLOWED_HOSTS lists those it does"
            raise RequestError(403, "host", detail)
        origin = headers.get("origin")
        if origin is not None and not self._allowed(origin.lower(), named.lower()):
            detail = f"pages of {origin!r} may not call this server; DRONE_ENV_ALLOWED_ORIGINS lists those that may"
            raise RequestError(403, "origin", detail)
        if self.expected is not None and scope["path"] not in OPEN_PATHS and not is_file(scope["path"]):
            given = _sent_token(scope) or _offered_token(scope)
            if not hmac.compare_digest(given, self.expected):
                detail = "this server asks for a token: send Authorization: Bearer TOKEN"
                raise RequestError(401, "token", detail, {"WWW-Authenticate": "Bearer"})

    def _answers(self, host: str, scope: Scope) -> bool:
        if host in self.hosts:
            return True
        if not listens_on_loopback(scope, self.listens):
            return not self.hosts
        return is_local_name(host) or host == self.listens

    def _allowed(self, origin: str, host: str) -> bool:
        # Hosts are compared, not schemes: behind a proxy that ends TLS the server sees http.
        scheme, _, authority = origin.partition("://")
        return origin in self.origins or (scheme in ("http", "https") and authority == host != "")


def _sent_token(scope: Scope) -> bytes:
    """The token of `Authorization: Bearer TOKEN`; the scheme may be written in any case (RFC 9110, 11.1)."""
    scheme, _, token = dict(scope["headers"]).get(b"authorization", b"").partition(b" ")
    return token.strip() if scheme.lower() == b"bearer" else b""


def _offered_token(scope: Scope) -> bytes:
    """The token from the subprotocol `bearer.` + URL-safe base64: browsers send no headers with a WebSocket."""
    for protocol in scope.get("subprotocols", []):
        if protocol.startswith(OFFER):
            text = protocol.removeprefix(OFFER)
            try:
                return base64.urlsafe_b64decode(text + "=" * (-len(text) % 4))
            except binascii.Error:
                return b""
    return b""


def protect(app: FastAPI, settings: Settings) -> None:
    """Put the middlewares around an application."""
    app.add_middleware(AllowedCallers, settings=settings)
    app.add_middleware(SecurityHeaders, frame_ancestors=settings.frame_ancestors)


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
