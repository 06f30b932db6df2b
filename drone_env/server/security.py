"""The middleware around every request: its origin and token, its headers, its line in the log."""

import hmac
import re
import time
from collections.abc import Awaitable, Callable

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from drone_env.server.exceptions import RequestError, answer_to
from drone_env.server.json_bodies import JsonRequest
from drone_env.server.logs import RequestLog
from drone_env.server.schemas import ENV_NAME
from drone_env.server.settings import Settings

OPEN_PATHS = {"/health", "/"}
"""These need no token, like the files of the page: health checks have none, and the page asks the user for it."""
WITHOUT_HINTS = re.compile(
    r"/(reset|step|state|session|path_history|health|metadata|schema|mcp/?|graders|kinds|list_environments|openapi\.json"
    rf"|(grade|tasks|{ENV_NAME})/?.*|ws)"
)
"""The paths of a server that withholds hints. All others, such as `/values`, may show a better flight."""
POLICY_VIOLATION = 1008
HEADERS = [
    (
        b"content-security-policy",
        b"default-src 'self'; object-src 'none'; base-uri 'none'; img-src 'self' data: blob:; "
        b"frame-ancestors 'self' https://huggingface.co https://*.hf.space",
    ),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
]
"""Headers of every response. Hugging Face may show the page in a frame."""


class Security:
    """Middleware that checks origin, token and body of a request, adds security and cache headers, and logs it.

    Browsers send the origin of a page in the `Origin` header; other programs send none.

    Args:
        app: The wrapped application.
        settings: The token, and whether hints are withheld.
        log: The request log.
        first: Answers some requests with bodies without the application; returns None for the others.
    """

    def __init__(
        self,
        app: ASGIApp,
        settings: Settings,
        log: RequestLog,
        first: Callable[[JsonRequest], Awaitable[Response | None]],
    ) -> None:
        self.app = app
        self.first = first
        self.log = log
        self.withholds = settings.withhold_hints
        self.expected = None if settings.token is None else settings.token.get_secret_value().encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on an allowed request. A refused WebSocket is closed before it opens."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        is_http, path = scope["type"] == "http", scope["path"]
        started, status = time.perf_counter(), 500 if is_http else 403

        async def send_with_headers(message: Message) -> None:
            nonlocal status
            if message["type"] == "websocket.accept":
                status = 101
            elif message["type"] == "http.response.start":
                status = message["status"]
                headers = [*message.get("headers", ()), *HEADERS]
                if b"cache-control" not in dict(headers):
                    # Browsers must revalidate the page, so that users see an update of the package at once.
                    is_page = path in ("/", "/docs") or path.startswith("/static/")
                    headers.append((b"cache-control", b"no-cache" if is_page else b"no-store"))
                message["headers"] = headers
            await send(message)

        answer: Response | None = None
        try:
            try:
                self._check(scope, Headers(scope=scope))
                if is_http and scope["method"] == "POST":
                    request = JsonRequest(scope, receive)
                    await request.read()
                    answer, receive = await self.first(request), request.again
            except RequestError as error:
                if not is_http:
                    await send({"type": "websocket.close", "code": POLICY_VIOLATION, "reason": str(error)[:120]})
                    return
                answer = answer_to(error, scope)
            await (answer or self.app)(scope, receive, send_with_headers)
        finally:
            self.log.add(scope["method"] if is_http else "WEBSOCKET", path, status, time.perf_counter() - started)

    def _check(self, scope: Scope, headers: Headers) -> None:
        origin, host = headers.get("origin"), headers.get("host", "").lower()
        # Behind a proxy that terminates TLS, the server sees http.
        if origin is not None and (not host or origin.lower() not in (f"http://{host}", f"https://{host}")):
            raise RequestError(403, "origin", f"origin {origin!r} is not allowed: pages of this server call it")
        if self.withholds and not WITHOUT_HINTS.fullmatch(scope["path"]):
            raise RequestError(403, "withheld", "this server withholds hints; see DRONE_ENV_WITHHOLD_HINTS")
        if self.expected is None or scope["path"] in OPEN_PATHS or scope["path"].startswith("/static/"):
            return
        scheme, _, token = headers.get("authorization", "").partition(" ")  # the scheme in any case: RFC 9110, 11.1
        if scheme.lower() != "bearer" or not hmac.compare_digest(token.strip().encode(), self.expected):
            detail = "this server requires a token: send Authorization: Bearer TOKEN"
            raise RequestError(401, "token", detail, {"WWW-Authenticate": "Bearer"})
