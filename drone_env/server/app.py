"""The application, and the command that serves it.

OpenEnv's server package is not imported: it costs seconds and 150 MB, most of it for Gradio. `openenv_socket` and
`routes.openenv` speak its protocol, and `grid_world_environment` is the environment for those who bring OpenEnv.
"""

import argparse
import asyncio
import errno
import logging
import os
import socket as sockets
import sys
import time
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response
from starlette.routing import WebSocketRoute

from drone_env import __version__
from drone_env.core.tasks import get_task
from drone_env.episodes.store import Store
from drone_env.errors import DroneEnvError, InvalidValueError, StoreError
from drone_env.registry import load_plugins
from drone_env.server.flight import DEFAULT_TASK
from drone_env.server.live.socket import LiveSocket
from drone_env.server.openenv_socket import OpenEnvSocket
from drone_env.server.problems import answers, install
from drone_env.server.request_log import LogRequests
from drone_env.server.routes import catalogue, flight, history, openenv, replay
from drone_env.server.security import protect
from drone_env.server.settings import Settings, load_settings, misspelt_variables
from drone_env.server.state import Shared

log = logging.getLogger(__name__)

API_VERSION = "1.0.0"
DESCRIPTION = f"""
A drone delivers parcels on a generated city grid. Version {__version__} of the package.

`POST /reset` opens a session and gives it back as `session_id`, as the header `X-Session-Id` and as a cookie; send it
with what follows. OpenEnv's clients connect to the WebSocket `/ws` instead, which is a session of its own.
"""
SWEEP_SECONDS = 5.0
PAGE = Path(__file__).with_name("static")
REVALIDATED = {"Cache-Control": "no-cache"}
"""Browsers ask whether a file has changed, so that an update of the package is seen at once."""


def create_app(settings: Settings | None = None, clock: Callable[[], float] | None = None) -> FastAPI:
    """The server as an ASGI application. Nothing is opened or written before it starts.

    Args:
        settings: The configuration; None for the environment's.
        clock: What tells the time in seconds, by which sessions are idle; None for a steady one.

    Raises:
        InvalidValueError: if a variable of the environment has a value that it cannot have.
    """
    load_plugins()
    shared = Shared(settings or load_settings(), clock)
    settings = shared.settings
    live = LiveSocket(shared)
    limits = settings.capacity, settings.idle_seconds, settings.max_bytes
    socket = OpenEnvSocket(lambda: shared.store, *limits, clock or time.monotonic)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncGenerator[None, None]:
        await run_in_threadpool(shared.open)
        sweeper = asyncio.create_task(_sweep(shared, socket, live))
        try:
            yield
        finally:
            sweeper.cancel()
            with suppress(asyncio.CancelledError):
                await sweeper
            await run_in_threadpool(socket.close)
            await run_in_threadpool(live.close)
            await run_in_threadpool(shared.close)

    app = FastAPI(
        title="Drone Delivery Env",
        version=API_VERSION,
        description=DESCRIPTION,
        lifespan=lifespan,
        responses=answers(401, 403),
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.shared = shared
    app.state.socket = socket
    app.state.live = live
    install(app)
    protect(app, settings)
    app.add_middleware(LogRequests, log=shared.requests)
    for routes in (flight, catalogue, history, replay, openenv):
        app.include_router(routes.router)
    app.router.routes.append(WebSocketRoute("/ws", socket))
    app.router.routes.append(WebSocketRoute("/live", live))
    _add_page(app, live)
    return app


def _add_page(app: FastAPI, live: LiveSocket) -> None:
    @app.get("/", include_in_schema=False)
    async def page() -> FileResponse:
        # Whoever opens the page will soon look at what can still be reached, and the first solver compiles for seconds.
        live.values.request(get_task(DEFAULT_TASK), 0)
        return FileResponse(PAGE / "index.html", headers=REVALIDATED)

    app.mount("/static", _Static(directory=PAGE))


class _Static(StaticFiles):
    def file_response(self, *arguments: Any, **options: Any) -> Response:
        response = super().file_response(*arguments, **options)
        response.headers.update(REVALIDATED)
        return response


async def _sweep(shared: Shared, socket: OpenEnvSocket, live: LiveSocket) -> None:
    """End what is idle, for ever."""
    interval = min(SWEEP_SECONDS, shared.settings.idle_seconds / 4)
    failing = ""
    while True:
        await asyncio.sleep(interval)
        try:
            await socket.close_idle()
            await run_in_threadpool(live.keep_sessions)
            await run_in_threadpool(shared.sessions.expire)
            failing = ""
        except DroneEnvError as error:
            if str(error) != failing:
                failing = str(error)
                log.error("idle sessions could not be ended; tried again every %g s: %s", interval, failing)


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve until told to stop. Options go before the environment.

    Args:
        arguments: Those of the command line if None.
    """
    try:
        defaults = load_settings()
    except DroneEnvError as error:
        sys.exit(f"server: {error}")
    parser = argparse.ArgumentParser("server", description="Serve the environment over HTTP and WebSocket.")
    parser.add_argument("--host", default=defaults.host, help="address to listen on (%(default)s)")
    parser.add_argument("--port", default=defaults.port, type=int, help="port to listen on (%(default)s)")
    parser.add_argument("--workers", default=defaults.workers, type=int, help="processes that serve (%(default)s)")
    parser.add_argument("--data", default=str(defaults.data), help="folder of what is kept (%(default)s)")
    given = parser.parse_args(arguments)
    try:
        run(given.host, given.port, given.workers, given.data)
    except DroneEnvError as error:
        sys.exit(f"server: {error}")


def run(host: str, port: int, workers: int, data: str) -> None:
    """Serve until told to stop.

    Args:
        host: Address to listen on.
        port: Port to listen on.
        workers: Processes that serve.
        data: Folder of what is kept.

    Raises:
        InvalidValueError: if one of them is not allowed, or the address is taken.
        StoreError: if the data folder cannot be used.
    """
    # The workers are processes of their own, which read the environment.
    chosen = {"HOST": host, "PORT": port, "WORKERS": workers, "DATA": data}
    os.environ.update({f"DRONE_ENV_{name}": str(value) for name, value in chosen.items()})
    settings = load_settings()
    _check_address(settings.host, settings.port)
    try:
        # Said here in a line: a worker that cannot open it prints a long trace, and so does each of the others.
        Store(settings.data).close()
    except StoreError:
        raise
    except OSError as error:
        raise StoreError(f"the data folder {settings.data} cannot be used: {error}") from None

    import uvicorn

    for name, meant in misspelt_variables().items():
        print(f"drone-env: {name} is not a setting and is ignored; is {meant} meant?", file=sys.stderr)
    url = f"http://{settings.host}:{settings.port}"
    print(f"drone-env {__version__}: {url}, docs at {url}/docs, data in {settings.data}", file=sys.stderr, flush=True)
    uvicorn.run(
        "drone_env.server.app:app",
        host=settings.host,
        port=settings.port,
        workers=settings.workers,
        access_log=False,
        # Below that uvicorn writes two lines for every WebSocket; `requests.log` has one, and is bounded.
        log_level="warning",
        server_header=False,
        ws_max_size=settings.max_bytes,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=5,
        # A caller that thinks for longer than the usual 5 s would find its connection closed under its next request.
        timeout_keep_alive=75,
        # After 5 s uvicorn would kill a worker that is merely slow, with its sockets, and without a word at this level.
        timeout_worker_healthcheck=60,
    )


def _check_address(host: str, port: int) -> None:
    """See whether one can listen there before anything is opened or made: uvicorn finds out last, and says less.

    Raises:
        InvalidValueError: if one cannot.
    """
    try:
        found = sockets.getaddrinfo(host, port, type=sockets.SOCK_STREAM, flags=sockets.AI_PASSIVE)
        for family, kind, protocol, _, address in found:
            with sockets.socket(family, kind, protocol) as probe:
                probe.setsockopt(sockets.SOL_SOCKET, sockets.SO_REUSEADDR, 1)
                if family == sockets.AF_INET6:
                    probe.setsockopt(sockets.IPPROTO_IPV6, sockets.IPV6_V6ONLY, 1)
                probe.bind(address)
    except OSError as error:
        if error.errno in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
            return  # a name may stand for several addresses, some of which this machine lacks: uvicorn takes the others
        told = f"cannot listen on {host}, port {port}: {error.strerror or error}"
        raise InvalidValueError(f"{told}; --host and --port choose another address") from None


app: FastAPI


def __getattr__(name: str) -> FastAPI:
    """`app`, made when it is first asked for: importing this module reads no configuration."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()["app"] = create_app()
    return value


if __name__ == "__main__":
    main()
