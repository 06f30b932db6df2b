"""The process of a server: its start, where it listens, how many connections it may have, and with whom it ends."""

import asyncio
import logging
import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from drone_env import __version__
from drone_env.envs.registry import register_reward_file
from drone_env.errors import InvalidValueError
from drone_env.results.store import Store
from drone_env.server.incoming import LARGE
from drone_env.server.predict import Networks
from drone_env.server.settings import load_settings, misspelt_variables

if sys.platform != "win32":
    import resource

RECEIVED, SENT = 16_384, 131_072
"""Bytes that the kernel keeps of a connection each way (Linux doubles them). What has come is read at once, which holds
up all others; what is to go would be megabytes for each caller that does not read.
"""
UNREAD_SECONDS = 75
"""Linux ends a connection whose other side has taken nothing of what it is sent for this many seconds."""
CONNECTIONS = 1000
"""Connections of a process, beside one for each session that it may have."""
STARTUP_FAILED = 3
"""Exit status where the application could not start, as uvicorn has it."""
LINES, LINE_SECONDS = 10, 60.0
"""Most lines that one place in the code logs within this time: callers cause some of them."""
OTHER_FILES = 128
"""Files of a process that are no connections: the store, logs, what a request opens."""


class BoundedLog(logging.Filter):
    """Drops lines beyond `LINES` from one place in the code, and traces of work that the server's end cancels."""

    def __init__(self) -> None:
        super().__init__()
        self._places: dict[tuple[str, int], tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether to log a line; the first after some that were dropped shows their number."""
        if record.exc_info and isinstance(record.exc_info[1], asyncio.CancelledError):
            return False
        place, now = (record.pathname, record.lineno), time.monotonic()
        since, count = self._places.get(place, (now, 0))
        if now - since >= LINE_SECONDS:
            if count > LINES:
                record.msg = f"{record.msg} ({count - LINES} such lines before this one were not logged)"
            since, count = now, 0
        self._places[place] = since, count + 1
        return count < LINES


LOGGING = {
    "version": 1,
    "disable_existing_loggers": False,
    "formatters": {"line": {"format": "%(levelname)s: %(message)s"}},
    "filters": {"bounded": {"()": BoundedLog}},
    "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "line", "filters": ["bounded"]}},
    "root": {"handlers": ["stderr"]},
}
"""Standard error as the only log."""


def run(
    host: str | None, port: int | None, workers: int | None, data: Path | None, reward_profiles: Sequence[Path] = ()
) -> None:
    """Serve until stopped; what is None comes from the environment.

    Args:
        host: Address to listen on.
        port: Port to listen on.
        workers: Processes that serve.
        data: Folder of what is kept.
        reward_profiles: Files of reward profiles.

    Raises:
        InvalidValueError: if one of them is not allowed, or the address is taken.
        OSError: if a file cannot be read.
        StoreError: if the data folder cannot be used.
    """
    # The workers are processes of their own, which read the environment.
    files = ",".join(map(str, reward_profiles)) or None
    chosen = {"HOST": host, "PORT": port, "WORKERS": workers, "DATA": data, "REWARD_PROFILES": files}
    os.environ.update({f"DRONE_ENV_{name}": str(value) for name, value in chosen.items() if value is not None})
    settings = load_settings()
    for file in settings.reward_profiles:
        register_reward_file(file)  # an error is said here in a line, as below
    import uvicorn
    from uvicorn.supervisors import Multiprocess

    with listen(settings.host, settings.port) as listening:
        # Said here in a line: a worker that cannot open it prints a long trace, and so does each of the others.
        Store(settings.data).close()
        for name, meant in misspelt_variables().items():
            print(f"drone-env: {name} is not a setting and is ignored; is {meant} meant?", file=sys.stderr)
        url = f"http://{settings.host}:{listening.getsockname()[1]}"
        folder = settings.data.resolve()
        print(f"drone-env {__version__}: {url}, docs at {url}/docs, files in {folder}", file=sys.stderr, flush=True)
        for line in Networks(settings.weights, settings.data).described():
            print(f"drone-env: {line}", file=sys.stderr, flush=True)
        config = uvicorn.Config(
            "drone_env.server.app:app",
            http="drone_env.server.protocols:Http",
            ws="drone_env.server.protocols:WebSockets",
            workers=settings.workers,
            log_config=LOGGING,
            access_log=False,
            # Below that uvicorn writes two lines for every WebSocket; `requests.log` has one, and is bounded.
            log_level="warning",
            server_header=False,
            ws_max_size=LARGE,
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
                Multiprocess(config, [listening]).run()
            else:
                server = uvicorn.Server(config)
                server.run([listening])
                if not server.started:
                    sys.exit(STARTUP_FAILED)


def listen(host: str, port: int) -> socket.socket:
    """Listen on an address.

    Args:
        host: The address, or a name that stands for an IPv4 address.
        port: The port; 0 for any that is free.

    Raises:
        InvalidValueError: if one cannot listen there.
    """
    try:
        sock = socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        message = f"cannot listen on {host}: {error.strerror}; --host and --port choose another address"
        raise InvalidValueError(message) from None
    # Linux has connections inherit these.
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVED)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENT)
    if sys.platform == "linux":
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNREAD_SECONDS * 1000)
    return sock


def most_connections(wanted: int) -> int:
    """How many connections this process may have: as many as wanted, or as its limit of open files leaves room for."""
    if sys.platform == "win32":
        return wanted
    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return wanted if files == resource.RLIM_INFINITY else min(wanted, max(files - OTHER_FILES, files // 2))


def end_with_parent() -> None:
    """Where this process is a worker: have it end when the process that started it is gone, however that ended."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="drone_env-parent", daemon=True).start()
