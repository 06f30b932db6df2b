"""`drone-env serve`: the server."""

from pathlib import Path

from drone_env.errors import needs


def serve(
    host: str | None = None,
    port: int | None = None,
    workers: int | None = None,
    data: Path | None = None,
) -> None:
    """Serve the environment: JSON over HTTP, OpenEnv over WebSocket; /docs describes both.

    Defaults come from the environment (`DRONE_ENV_HOST` and so on), else they are 127.0.0.1, 8000, 1 and `data`.

    Example: drone-env serve --port 8000

    Args:
        host: Address to listen on; 0.0.0.0 for all interfaces.
        port: Port to listen on.
        workers: Number of processes.
        data: Folder of episodes, sessions and logs.
    """
    with needs("server"):
        from drone_env.server.process import run
    run(host, port, workers, data)


def main() -> None:
    """The program `server`; see `server --help`."""
    with needs("server", "__main__"):
        from drone_env.server.app import main as server
    server()
