"""Several servers on one data folder behind nginx, configured by `deploy/nginx.conf`."""

import os
import re
import subprocess
from collections.abc import Iterable
from pathlib import Path

from tests.api.serving import Server
from tests.tools import PATIENCE, ROOT, eventually, find_tool, is_taken, reserved_port

COMMAND = ["-m", "drone_env.cli", "serve"]
FAILURES = "max_fails=2 fail_timeout=5s"


class Nginx:
    """A running nginx with the configuration of `deploy/nginx.conf`.

    Args:
        folder: For its files; must exist.
        ports: The ports of the servers.
        failures: When a server counts as failed.
    """

    def __init__(self, folder: Path, ports: Iterable[int], failures: str = FAILURES) -> None:
        self.command = [find_tool("nginx"), "-e", str(folder / "error.log"), "-p", str(folder), "-c", "nginx.conf"]
        port = reserved_port()
        self.url = f"http://127.0.0.1:{port}"
        text = (ROOT / "deploy" / "nginx.conf").read_text(encoding="utf-8")
        text, listens = re.subn(r"listen 127\.0\.0\.1:8080;", f"listen 127.0.0.1:{port};", text)
        servers = " ".join(f"server 127.0.0.1:{each} {failures};" for each in ports)
        text, upstreams = re.subn(r"(server 127\.0\.0\.1:\d+ [^;]*;\s*)+", f"{servers}\n", text)
        assert (listens, upstreams) == (1, 2)
        # pytest's folders belong to whoever runs the tests, and root's nginx would have workers of another user.
        user = "user root;\n" if os.geteuid() == 0 else ""
        (folder / "nginx.conf").write_text(user + text, encoding="utf-8")
        self.process = subprocess.Popen([*self.command, "-g", "daemon off;"])
        try:
            eventually(lambda: is_taken(port), (folder / "error.log").read_text)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End it."""
        self.process.terminate()
        self.process.wait(PATIENCE)


class Cluster:
    """Running servers, and nginx before them.

    Args:
        folder: For the data and nginx's files; must be there.
        count: How many servers.
        settings: Of each server, without the prefix.
    """

    def __init__(self, folder: Path, count: int, **settings: str) -> None:
        self.folder = folder
        self.settings = settings
        self.servers: dict[int, Server] = {}
        ports = sorted(reserved_port() for _ in range(count))
        self.nginx = Nginx(folder, ports)
        self.url = self.nginx.url
        try:
            for port in ports:
                self.start(port)
        except BaseException:
            self.close()
            raise

    def answered(self, path: str) -> dict[int, int]:
        """How many of the last 200 requests of each server were for a path."""
        logs = {port: server.client.get("/terminal_logs").json() for port, server in self.servers.items()}
        return {port: sum(request["path"] == path for request in log["requests"]) for port, log in logs.items()}

    def start(self, port: int) -> Server:
        """Start the server of a port, also again."""
        self.servers[port] = Server(COMMAND, self.folder / "data", port, self.settings)
        return self.servers[port]

    def close(self) -> None:
        """End all of it."""
        for server in self.servers.values():
            if server.process.poll() is None:
                server.kill()
        self.nginx.close()
