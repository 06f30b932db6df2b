"""The server process: uvicorn's configuration, and the listening socket."""

import asyncio
import logging
import multiprocessing
import os
import signal
import socket
import sys
import threading
from contextlib import suppress
from multiprocessing import resource_tracker
from pathlib import Path

from drone_env import __version__
from drone_env.errors import InvalidValueError
from drone_env.flights.store import Store
from drone_env.server.json_bodies import LARGEST_BODY
from drone_env.server.settings import load_settings


def is_news(record: logging.LogRecord) -> bool:
    """Whether a line of uvicorn's log is not about a task that was cancelled because the server stops."""
    cancelled = record.exc_info and isinstance(record.exc_info[1], asyncio.CancelledError)
    return not (cancelled or record.getMessage().rstrip().endswith("CancelledError"))


def run(
    host: str | None = None,
    port: int | None = None,
    workers: int | None = None,
    data: Path | None = None,
) -> None:
    """Serve until stopped. Defaults come from the environment: DRONE_ENV_HOST and so on.

    Args:
        host: Address to listen on.
        port: Port to listen on.
        workers: Number of server processes.
        data: Data folder.

    Raises:
        InvalidValueError: if an argument is not allowed, or the address is taken.
        OSError: if the data folder cannot be created.
        StoreError: if the data folder cannot be used.
    """
    # Server processes read the environment.
    options = {"host": host, "port": port, "workers": workers, "data": data}
    given = {name: str(value) for name, value in options.items() if value is not None}
    os.environ.update({f"DRONE_ENV_{name.upper()}": value for name, value in given.items()})
    settings = load_settings(given)
    import uvicorn
    from uvicorn.config import STARTUP_FAILURE
    from uvicorn.supervisors import Multiprocess

    class Supervisor(Multiprocess):
        """Starts a process again as soon as it has ended."""

        def keep_subprocess_alive(self) -> None:
            for process in self.processes:
                # uvicorn also holds the other end of the pipe, so it would wait for a starting process that was killed.
                process.child_conn.close()
            super().keep_subprocess_alive()

    with listen(settings.host, settings.port) as listening:
        Store(settings.data).close()  # raises here; in a server process it would log a long trace
        url = f"http://{settings.host}:{listening.getsockname()[1]}"
        folder = settings.data.resolve()
        print(f"drone-env {__version__}: {url}, docs at {url}/docs, files in {folder}", file=sys.stderr, flush=True)
        config = uvicorn.Config(
            "drone_env.server.app:app",
            ws="websockets-sansio",
            workers=settings.workers,
            log_config=None,
            access_log=False,
            log_level="error",  # uvicorn logs a line for each WebSocket and for each invalid request otherwise
            server_header=False,
            ws_max_size=LARGEST_BODY,
            ws_per_message_deflate=False,
            ws_ping_timeout=max(settings.idle_seconds, 60.0),  # longer than two pings
            timeout_graceful_shutdown=5,
            timeout_keep_alive=75,  # the default of 5 s closes connections of agents that compute for longer
            timeout_worker_healthcheck=60,  # time for a process to start at SIGHUP; the default of 5 s can be too short
        )
        # `uvicorn.run` would bind its own socket.
        with suppress(KeyboardInterrupt):
            if settings.workers > 1:
                # A thread receives Ctrl-C, and no process that this one starts: it tells them to stop.
                threading.Thread(target=threading.Event().wait, name="drone_env-ctrl-c", daemon=True).start()
                leave_ctrl_c()
                first = Supervisor(config, [listening])
                first.run()
                failed = any(process.exitcode == STARTUP_FAILURE for process in first.processes)
            else:
                server = uvicorn.Server(config)
                try:
                    server.run([listening])
                finally:
                    if server.force_exit:  # a second Ctrl-C; the interpreter would wait for threads that never end
                        for child in multiprocessing.active_children():
                            child.kill()
                        os._exit(0)
                failed = not server.started
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C once more, at the very end, changes no status
            if failed:
                sys.exit(1)


def leave_ctrl_c() -> None:
    """Keep Ctrl-C from this thread, and from the threads and processes that it starts. A terminal sends it to all."""
    if sys.platform != "win32":
        resource_tracker.ensure_running()  # its start would unblock the signal later
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])


def listen(host: str, port: int) -> socket.socket:
    """Listen on an address.

    Args:
        host: Address, or a name that resolves to an IPv4 address.
        port: Port; 0 for any free port.

    Raises:
        InvalidValueError: if the address is not available.
    """
    try:
        return socket.create_server((host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        message = f"cannot listen on {host}: {error.strerror}; --host and --port choose another address"
        raise InvalidValueError(message) from None


def end_with_parent() -> None:
    """End this process when its parent process ends, even if the parent is killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="drone_env-parent", daemon=True).start()
