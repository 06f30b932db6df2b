"""Who may call, and with what: pure ASGI middlewares, one job each.

From the outside in: `SecurityHeaders`, `AllowedHosts`, `AllowedOrigins`, `BearerToken`, `JsonBodies`. What a body says
is then found in the scope, under `BODY`.
"""

import base64
import binascii
import hmac
from collections.abc import Callable, Collection
from pathlib import Path

from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drone_env.errors import InvalidValueError
from drone_env.server.local import host_name, is_local_name, listens_on_loopback
from drone_env.server.problems import problem
from drone_env.server.settings import Settings
from drone_env.server.strict_json import parse_json

PAGE = Path(__file__).with_name("static")
ART = Path(__file__).parents[1] / "envs" / "art"
"""What the pictures of Gymnasium and the page are both drawn from."""
OPEN_PATHS = {"/health", "/"} | {
    f"/static/{path.relative_to(folder).as_posix()}" for folder in (PAGE, ART) for path in folder.rglob("*.*")
}
"""Answered without a token: whoever watches over the process has none, and the page asks for it."""
POLICY_VIOLATION = 1008
OFFER = "bearer."
BODY = "drone_env.body"
"""Where a scope has the value of its request's body, once `JsonBodies` has let that through."""


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
            f"default-src 'self'; object-src 'none'; base-uri 'none'; frame-ancestors {framing}; "
            "img-src 'self' data: blob:; connect-src 'self' ws: wss:"
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

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                told = [*message.get("headers", ()), *self.headers]
                if not any(name.lower() == b"cache-control" for name, _ in told):
                    told.append((b"cache-control", b"no-store"))
                message["headers"] = told
            await send(message)

        await self.app(scope, receive, send_with_headers)


class AllowedHosts:
    """Answers only what is addressed to these hosts.

    A server that listens on loopback also answers for the names of this machine, and where `hosts` is empty for them
    alone: otherwise any web page whose name is made to lead there could call it.

    Args:
        app: The application within.
        hosts: Names without port; empty for all.
        listens: Where the settings have the server listen.
    """

    def __init__(self, app: ASGIApp, hosts: Collection[str], listens: str) -> None:
        self.app = app
        self.hosts = {host.lower() for host in hosts}
        self.listens = listens.lower()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what is addressed to us."""
        if scope["type"] in ("http", "websocket"):
            host = host_name(Headers(scope=scope).get("host", ""))
            if not self._answers(host, scope):
                detail = f"this server does not answer for host {host!r}; DRONE_ENV_ALLOWED_HOSTS lists those it does"
                await refuse(scope, receive, send, 403, "host", detail)
                return
        await self.app(scope, receive, send)

    def _answers(self, host: str, scope: Scope) -> bool:
        if host in self.hosts:
            return True
        if not listens_on_loopback(scope, self.listens):
            return not self.hosts
        return is_local_name(host) or host == self.listens


class AllowedOrigins:
    """Refuses web pages of other origins, which browsers name in the `Origin` header. Programs send none.

    Args:
        app: The application within.
        origins: Allowed beside the origin of the server itself, such as `https://example.org`.
    """

    def __init__(self, app: ASGIApp, origins: Collection[str]) -> None:
        self.app = app
        self.origins = {origin.lower().rstrip("/") for origin in origins}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what comes from an allowed origin, or from none."""
        if scope["type"] in ("http", "websocket"):
            headers = Headers(scope=scope)
            origin = headers.get("origin")
            if origin is not None and not self._allowed(origin.lower(), headers.get("host", "").lower()):
                detail = f"pages of {origin!r} may not call this server; DRONE_ENV_ALLOWED_ORIGINS lists those that may"
                await refuse(scope, receive, send, 403, "origin", detail)
                return
        await self.app(scope, receive, send)

    def _allowed(self, origin: str, host: str) -> bool:
        # Hosts are compared, not schemes: behind a proxy that ends TLS the server sees http.
        scheme, _, authority = origin.partition("://")
        return origin in self.origins or (scheme in ("http", "https") and authority == host != "")


class BearerToken:
    """Asks for a token.

    Args:
        app: The application within.
        token: The token; None to ask for none.
    """

    def __init__(self, app: ASGIApp, token: str | None) -> None:
        self.app = app
        self.expected = None if token is None else token.encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what carries the token."""
        if self.expected is not None and scope["type"] in ("http", "websocket") and scope["path"] not in OPEN_PATHS:
            given = _sent_token(scope) or _offered_token(scope)
            if not hmac.compare_digest(given, self.expected):
                detail = "this server asks for a token: send Authorization: Bearer TOKEN"
                await refuse(scope, receive, send, 401, "token", detail, {"WWW-Authenticate": "Bearer"})
                return
        await self.app(scope, receive, send)


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


class JsonBodies:
    """Lets through bodies that are small, declared as JSON, and JSON; or empty.

    Args:
        app: The application within.
        max_bytes: The largest body.
    """

    def __init__(self, app: ASGIApp, max_bytes: int) -> None:
        self.app = app
        self.max_bytes = max_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Read the body, and pass it on if it is fit."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if headers.get("content-length") in (None, "0") and "transfer-encoding" not in headers:
            await self.app(scope, receive, send)
            return
        body = bytearray()
        more = True
        while more:
            message = await receive()
            if message["type"] == "http.disconnect":
                return
            body += message.get("body", b"")
            more = message.get("more_body", False)
            if len(body) > self.max_bytes:
                detail = f"a body may have {self.max_bytes} bytes"
                await refuse(scope, receive, send, 413, "too_large", detail, {"Connection": "close"})
                return
        if body:
            kind = headers.get("content-type", "").partition(";")[0].strip().lower()
            if kind != "application/json":
                detail = f"a body must be declared as Content-Type: application/json, got {kind!r}"
                await refuse(scope, receive, send, 415, "content_type", detail)
                return
            try:
                scope[BODY] = parse_json(body.decode("utf-8"))
            except UnicodeDecodeError:
                await refuse(scope, receive, send, 400, "not_json", "the body is not UTF-8")
                return
            except InvalidValueError as error:
                await refuse(scope, receive, send, 400, "not_json", str(error))
                return
        await self.app(scope, _replayed(bytes(body), receive), send)


def _replayed(body: bytes, receive: Receive) -> Receive:
    """`receive` with the body that was read already at its start."""
    pending = [body]

    async def replay() -> Message:
        if pending:
            return {"type": "http.request", "body": pending.pop(), "more_body": False}
        return await receive()

    return replay


async def refuse(
    scope: Scope,
    receive: Receive,
    send: Send,
    status: int,
    code: str,
    detail: str,
    headers: dict[str, str] | None = None,
) -> None:
    """Answer with a problem; a WebSocket is closed before it opens."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": POLICY_VIOLATION, "reason": detail[:120]})
        return
    await problem(status, code, detail, headers=headers)(scope, receive, send)


def protect(app: FastAPI, settings: Settings) -> None:
    """Put the middlewares around an application."""
    token = None if settings.token is None else settings.token.get_secret_value()
    layers: list[tuple[Callable[..., ASGIApp], dict[str, object]]] = [
        (JsonBodies, {"max_bytes": settings.max_bytes}),
        (BearerToken, {"token": token}),
        (AllowedOrigins, {"origins": settings.allowed_origins}),
        (AllowedHosts, {"hosts": settings.allowed_hosts, "listens": settings.host}),
        (SecurityHeaders, {"frame_ancestors": settings.frame_ancestors}),
    ]
    for layer, options in layers:
        app.add_middleware(layer, **options)  # pyright: ignore[reportArgumentType]
