"""The ASGI application, and the command that serves it.

OpenEnv's server package is not imported, because it takes seconds and 150 MB. `server.openenv` and `routes.openenv`
implement its protocol; `grid_world_environment` is the environment for use with that package.
"""

import asyncio
import logging
import sys
import time
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from functools import partial

from drone_env import __version__
from drone_env.errors import DroneEnvError, needs

with needs("server", __name__):
    from fastapi import FastAPI
    from fastapi.staticfiles import StaticFiles
    from starlette.concurrency import run_in_threadpool
    from starlette.routing import WebSocketRoute

from drone_env.envs.registry import load_plugins
from drone_env.server import mcp
from drone_env.server.exceptions import error_responses, install
from drone_env.server.openenv import OpenEnvSocket
from drone_env.server.page_files import ART, PAGE
from drone_env.server.process import end_with_parent, is_news, run
from drone_env.server.routes import (
    catalogue,
    compare,
    flight,
    flights,
    history,
    maps,
    openenv,
    page,
    replay,
)
from drone_env.server.routes.flight import answer_step
from drone_env.server.security import Security
from drone_env.server.settings import Settings, load_settings
from drone_env.server.state import AppState

log = logging.getLogger(__name__)

DESCRIPTION = """
A drone delivers parcels on a generated city grid.

`POST /reset` opens a session and returns its id as `session_id`, as the header `X-Session-Id` and as a cookie. Send it
with every further request. OpenEnv's clients use the WebSocket `/ws` instead; each connection is a session.
"""
SWEEP_SECONDS = 5.0


def create_app(settings: Settings | None = None, clock: Callable[[], float] | None = None) -> FastAPI:
    """Create the ASGI application. It opens and writes no file before it starts.

    Args:
        settings: The settings; None to read the environment.
        clock: Returns the time in seconds, for idle times; None for a monotonic clock.

    Raises:
        InvalidValueError: if an environment variable is invalid.
    """
    load_plugins()
    settings = settings or load_settings()
    app_state = AppState(settings, clock)
    socket = OpenEnvSocket(app_state, clock or time.monotonic)

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncGenerator[None, None]:
        await run_in_threadpool(app_state.open)
        sweeper = asyncio.create_task(_sweep(app_state, socket))
        try:
            yield
        finally:
            sweeper.cancel()
            with suppress(asyncio.CancelledError):
                await sweeper
            await run_in_threadpool(app_state.close)

    app = FastAPI(
        title="Drone Delivery Env",
        version=__version__,
        description=DESCRIPTION,
        lifespan=lifespan,
        responses=error_responses(401, 403),
        generate_unique_id_function=lambda route: route.name,
        # FastAPI's own pages load scripts from a CDN.
        docs_url=None,
        redoc_url=None,
        # FastAPI would look for exporters of OpenTelemetry in each request.
        telemetry={"tracing": False, "metrics": False, "logs": False},
    )
    app.state.shared = app_state
    app.state.socket = socket
    install(app)
    app.add_middleware(Security, settings=settings, log=app_state.requests, first=partial(answer_step, app_state))
    for routes in (flight, flights, catalogue, history, compare, replay, maps, page, openenv, mcp):
        app.include_router(routes.router)
    app.router.routes.append(WebSocketRoute("/ws", socket))
    app.mount("/static", StaticFiles(directory=PAGE, packages=[("drone_env.envs", ART.name)]))
    return app


async def _sweep(app_state: AppState, socket: OpenEnvSocket) -> None:
    """End idle sessions and sockets periodically."""
    interval = min(SWEEP_SECONDS, app_state.settings.idle_seconds / 4)
    while True:
        await asyncio.sleep(interval)
        try:
            await socket.close_idle()
            await run_in_threadpool(app_state.sessions.expire)
        except DroneEnvError as error:
            log.error("cannot end idle sessions, next attempt in %g s: %s", interval, error)


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve until stopped. Options override environment variables.

    Args:
        arguments: The options; None for those of the command line.
    """
    import tyro  # every worker process would load it

    try:
        tyro.cli(run, prog="server", args=arguments)
    except (DroneEnvError, OSError) as error:
        sys.exit(f"server: {error}")


app: FastAPI


def __getattr__(name: str) -> FastAPI:
    """Create `app` on first access, so that importing this module reads no settings."""
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()["app"] = create_app()
    logging.getLogger("uvicorn.error").addFilter(is_news)
    end_with_parent()
    return value


if __name__ == "__main__":
    main()
