"""The application, and the command that serves it.

OpenEnv's server package is not imported: it costs seconds and 150 MB, most of it for Gradio. `openenv.socket` and
`openenv.routes` speak its protocol, and `openenv.environment` is the environment for those who bring OpenEnv.
"""

import argparse
import asyncio
import logging
import os
import sys
import time
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import ExitStack, asynccontextmanager, suppress
from functools import cache
from typing import Any

from drone_env import __version__
from drone_env.core.tasks import get_task
from drone_env.episodes.store import Store
from drone_env.errors import DroneEnvError, StoreError, needs

with needs("server", __name__):
    from fastapi import FastAPI
    from fastapi.responses import FileResponse
    from fastapi.staticfiles import StaticFiles
    from pydantic_core import to_json
    from starlette.concurrency import run_in_threadpool
    from starlette.responses import Response
    from starlette.routing import WebSocketRoute

from drone_env.envs.registry import load_plugins
from drone_env.server.live.socket import LiveSocket
from drone_env.server.map_choice import DEFAULT_TASK
from drone_env.server.openenv import routes as openenv
from drone_env.server.openenv.socket import OpenEnvSocket
from drone_env.server.plain_steps import PlainSteps
from drone_env.server.predict import Networks
from drone_env.server.problems import answers, install
from drone_env.server.process import end_with_parent, listen, most_connections
from drone_env.server.request_log import LogRequests
from drone_env.server.routes import catalogue, flight, history, replay
from drone_env.server.security import PAGE, protect
from drone_env.server.settings import Settings, load_settings, misspelt_variables
from drone_env.server.state import Shared

log = logging.getLogger(__name__)

DESCRIPTION = """
A drone delivers parcels on a generated city grid.

`POST /reset` opens a session and gives it back as `session_id`, as the header `X-Session-Id` and as a cookie; send it
with what follows. OpenEnv's clients connect to the WebSocket `/ws` instead, which is a session of its own.
"""
SWEEP_SECONDS = 5.0
CONNECTIONS = 1000
"""Connections of a process, beside one for each session that it may have."""
STARTUP_FAILED = 3
"""Exit status where the application could not start, as uvicorn has it."""
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
    socket = OpenEnvSocket(shared, clock or time.monotonic)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncGenerator[None, None]:
        await run_in_threadpool(shared.open)
        # Seen where uvicorn itself was started; the command has printed it.
        for line in shared.networks.told():
            logging.getLogger("uvicorn.error").info("%s", line)
        sweeper = asyncio.create_task(_sweep(shared, socket, live))
        try:
            yield
        finally:
            sweeper.cancel()
            with suppress(asyncio.CancelledError):
                await sweeper
            await run_in_threadpool(live.close)
            await run_in_threadpool(shared.close)

    app = FastAPI(
        title="Drone Delivery Env",
        version=__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        responses=answers(401, 403),
        generate_unique_id_function=lambda route: route.name,
        # FastAPI's own pages fetch their scripts from elsewhere.
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
    )
    app.state.shared = shared
    app.state.socket = socket
    app.state.live = live
    install(app)
    # The first is the innermost.
    app.add_middleware(PlainSteps, shared=shared)
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

    @app.get("/docs", include_in_schema=False)
    async def docs() -> FileResponse:
        return FileResponse(PAGE / "docs.html", headers=REVALIDATED)

    description = cache(lambda: to_json(app.openapi()))

    # FastAPI's own holds up the event loop, and writes it each time.
    @app.get("/openapi.json", include_in_schema=False)
    def openapi() -> Response:
        return Response(description(), media_type="application/json")

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
    import uvicorn
    from uvicorn.supervisors import Multiprocess

    with ExitStack() as opened:
        sockets = [opened.enter_context(sock) for sock in listen(settings.host, settings.port)]
        try:
            # Said here in a line: a worker that cannot open it prints a long trace, and so does each of the others.
            Store(settings.data).close()
        except StoreError:
            raise
        except OSError as error:
            raise StoreError(f"the data folder {settings.data} cannot be used: {error}") from None
        for name, meant in misspelt_variables().items():
            print(f"drone-env: {name} is not a setting and is ignored; is {meant} meant?", file=sys.stderr)
        url = f"http://{settings.host}:{sockets[0].getsockname()[1]}"
        print(
            f"drone-env {__version__}: {url}, docs at {url}/docs, data in {settings.data}", file=sys.stderr, flush=True
        )
        for line in Networks(settings.weights, settings.data).told():
            print(f"drone-env: {line}", file=sys.stderr, flush=True)
        config = uvicorn.Config(
            "drone_env.server.app:app",
            http="drone_env.server.protocols:Http",
            ws="drone_env.server.protocols:WebSockets",
            workers=settings.workers,
            access_log=False,
            # Below that uvicorn writes two lines for every WebSocket; `requests.log` has one, and is bounded.
            log_level="warning",
            server_header=False,
            ws_max_size=settings.max_bytes,
            ws_per_message_deflate=False,
            limit_concurrency=most_connections(CONNECTIONS + settings.capacity),
            timeout_graceful_shutdown=5,
            # A caller that thinks for longer than the usual 5 s would find its connection closed under what it sends.
            timeout_keep_alive=75,
            # After 5 s uvicorn would kill a worker that is merely slow, with its sockets, and without a word.
            timeout_worker_healthcheck=60,
        )
        # As `uvicorn.run` does, which would bind by itself.
        with suppress(KeyboardInterrupt):
            if settings.workers > 1:
                Multiprocess(config, sockets).run()
            else:
                server = uvicorn.Server(config)
                server.run(sockets)
                if not server.started:
                    sys.exit(STARTUP_FAILED)


app: FastAPI


def __getattr__(name: str) -> FastAPI:
    """`app`, made when it is first asked for: importing this module reads no configuration."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()["app"] = create_app()
    end_with_parent()
    return value


if __name__ == "__main__":
    main()
