"""A server that takes every request and dies before it answers: the worst moment, each time."""

import socket
import threading
from types import TracebackType

from typing_extensions import Self


class Forgetful:
    """Hands requests on to a real server, and closes the connection when that has answered.

    Args:
        port: Of the real server.
    """

    def __init__(self, port: int) -> None:
        self.taken = 0
        self._real = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join(10)

    def _serve(self) -> None:
        while True:
            try:
                caller, _ = self._listener.accept()
            except OSError:
                return
            # The requests here fit into one read; the answer has begun when the step is kept.
            with caller, socket.create_connection(("127.0.0.1", self._real)) as real:
                real.sendall(caller.recv(1 << 16))
                assert real.recv(1 << 16).startswith(b"HTTP/1.1 200")
                self.taken += 1
