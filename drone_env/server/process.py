"""The process of a server: where it listens, how many connections it may have, and with whom it ends."""

import errno
import multiprocessing
import os
import signal
import socket
import sys
import threading
from contextlib import ExitStack
from typing import Any

from drone_env.errors import InvalidValueError

if sys.platform != "win32":
    import resource

RECEIVED, SENT = 16_384, 131_072
"""Bytes that the kernel keeps of a connection each way (Linux doubles them). What has come is read at once, which holds
up all others; what is to go would be megabytes for each caller that does not read.
"""
UNREAD_SECONDS = 75
"""Linux ends a connection whose other side has taken nothing for so long of what it is sent."""
OTHER_FILES = 128
"""Files of a process that are no connections: the store, logs, what a request opens."""


def listen(host: str, port: int) -> list[socket.socket]:
    """Listen on every address of a name.

    Args:
        host: A name or an address.
        port: The port; 0 for any that is free.

    Raises:
        InvalidValueError: if one cannot listen there.
    """
    sockets: list[socket.socket] = []
    lacking: OSError | None = None
    with ExitStack() as opened:
        try:
            for *kind, _, address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE):
                chosen = sockets[0].getsockname()[1] if sockets else port
                try:
                    sockets.append(opened.enter_context(_listening(kind, (address[0], chosen, *address[2:]))))
                except OSError as error:
                    # A name may stand for several addresses, some of which this machine lacks.
                    if error.errno not in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
                        raise
                    lacking = error
            if lacking is not None and not sockets:
                raise lacking
        except OSError as error:
            told = f"cannot listen on {host}, port {port}: {error.strerror or error}"
            raise InvalidValueError(f"{told}; --host and --port choose another address") from None
        opened.pop_all()
    return sockets


def _listening(kind: list[Any], address: tuple[Any, ...]) -> socket.socket:
    sock = socket.socket(*kind)
    try:
        if os.name == "posix":  # elsewhere that lets two servers share a port
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if sock.family == socket.AF_INET6:
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        # Linux has connections inherit these.
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVED)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENT)
        if sys.platform == "linux":
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNREAD_SECONDS * 1000)
        sock.bind(address)
        sock.listen()
    except BaseException:
        sock.close()
        raise
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
