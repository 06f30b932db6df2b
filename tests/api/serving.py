"""A server process, started as users start it."""

import os
import signal
import subprocess
import sys
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import httpx

from tests.tools import PATIENCE, ROOT, eventually, reserved_port


class Server:
    """A running server.

    Args:
        command: Arguments of the interpreter.
        data: The data folder.
        port: The port.
        settings: Environment variables without the prefix.
    """

    def __init__(self, command: list[str], data: Path, port: int, settings: dict[str, str]) -> None:
        self.url = f"http://127.0.0.1:{port}"
        # AppState, because each client reads the system's certificates, which is slow. It keeps no connection open.
        self.client = httpx.Client(
            base_url=self.url, timeout=PATIENCE, limits=httpx.Limits(max_keepalive_connections=0)
        )
        variables = {f"DRONE_ENV_{name}": value for name, value in settings.items()}
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "DRONE_ENV_DATA": str(data), **variables}
        self.data = data
        self.log = data.parent / f"server-{port}.log"
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, *command, "--port", str(port)], cwd=ROOT, env=environment, stdout=log, stderr=log
            )
        try:
            eventually(self._answers, self.log.read_text)
        except BaseException:
            self.kill()
            raise

    def _answers(self) -> bool:
        assert self.process.poll() is None, self.log.read_text()
        try:
            return self.client.get("/health", timeout=1).status_code == 200
        except httpx.HTTPError:
            return False

    def assert_well(self) -> None:
        """A page can fly, the health is good, and nothing has failed."""
        start = {"task": "easy", "seed": 7, "pilot": "greedy"}
        self.client.post("/flights/agent", json=start).raise_for_status()
        assert self.client.get("/health").status_code == 200
        assert "Traceback" not in self.log.read_text()

    def kill(self) -> None:
        """Kill the process."""
        self.client.close()
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def stop(self) -> None:
        """Terminate the process, and wait."""
        self.process.terminate()
        try:
            self.process.wait(PATIENCE)
        finally:
            self.kill()


@contextmanager
def serving(
    data: Path, command: tuple[str, ...] = ("drone_env/server/app.py",), port: int | None = None, **settings: str
) -> Generator[Server, None, None]:
    """Context manager of a running server."""
    server = Server(list(command), data, port or reserved_port(), settings)
    try:
        yield server
    finally:
        server.client.close()
        if server.process.poll() is None:
            server.stop()
