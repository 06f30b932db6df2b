"""Tools that tests need from the machine."""

import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn

import pytest

LEFT_OUT = ("pyright", "ray", "sb3_contrib", "stable_baselines3", "tensorboard", "torch")
"""The large packages that `uv sync` leaves out; the extra `dev` contains them."""
ABSENT = [name for name in LEFT_OUT if find_spec(name) is None]


def missing_tool(name: str) -> NoReturn:
    """Skip the test that needs `name`, or fail it if `DRONE_ENV_REQUIRE_TOOLS=1`."""
    if os.environ.get("DRONE_ENV_REQUIRE_TOOLS") == "1":
        pytest.fail(f"missing tool: {name}")
    pytest.skip(f"missing tool: {name}")


def missing_package(failure: str) -> str | None:
    """Return the missing large package that a failure report of pytest names, if any."""
    if os.environ.get("DRONE_ENV_REQUIRE_TOOLS") == "1":
        return None
    named = re.findall(r"(?<=No module named ')\w+|\w+(?= is not installed; run)", failure)
    return next((name for name in named if name in ABSENT), None)


def missing_in(reasons: Iterable[str]) -> list[str]:
    """Return the missing tools that skip reasons of pytest name."""
    return sorted({found[1] for reason in reasons if (found := re.search(r"missing tool: ([^'\n]+)", reason))})


def find_python(version: str) -> str:
    """Path of a working interpreter of this version, such as "3.13"."""
    return path_of_python(version) or missing_tool(f"Python {version}")


def path_of_python(version: str) -> str | None:
    """Like `find_python`, but None if there is none."""
    pyenv = sorted(Path.home().glob(f".pyenv/versions/{version}.*/bin/python"))
    candidates = filter(None, (shutil.which(f"python{version}"), *map(str, pyenv)))
    # A name on the path may be a shim that refuses to run.
    return next((candidate for candidate in candidates if _version(candidate) == version), None)


def _version(python: str) -> str:
    code = "import sys; print('%d.%d' % sys.version_info[:2])"
    return subprocess.run([python, "-c", code], capture_output=True, text=True, check=False).stdout.strip()


def find_uv() -> str:
    """Return the path of uv, of this environment or on `PATH`."""
    return shutil.which("uv", path=str(Path(sys.executable).parent)) or shutil.which("uv") or missing_tool("uv")


def eventually(holds: Callable[[], object]) -> None:
    """Wait until a condition is true, for at most a minute."""
    deadline = time.monotonic() + 60
    while not holds():
        assert time.monotonic() < deadline, "timed out"
        time.sleep(0.02)


_RESERVED: list[socket.socket] = []


def reserved_port() -> int:
    """Return a port for a server of the tests, reserved as long as this process lives.

    It is bound but not listened on: the kernel gives it to no other process, and a server that names it can listen on
    it (with SO_REUSEADDR).
    """
    sock = socket.socket()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind(("127.0.0.1", 0))
    _RESERVED.append(sock)
    return sock.getsockname()[1]


if __name__ == "__main__":
    print(path_of_python(sys.argv[1]) or sys.exit(f"Python {sys.argv[1]} is neither on the path nor below ~/.pyenv"))
