"""Tools that tests need from the machine."""

import atexit
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).parents[1]
PATIENCE = 300
"""Seconds to wait for a program or a response: on a busy machine the first compilation takes minutes."""
LEFT_OUT = ("pyright", "ray", "sb3_contrib", "stable_baselines3", "tensorboard", "torch")
"""The large packages that `uv sync` leaves out; the extra `dev` contains them."""
ABSENT = [name for name in LEFT_OUT if find_spec(name) is None]


def missing_tool(name: str) -> NoReturn:
    """Skip the test that needs `name`, or fail it if `DRONE_ENV_REQUIRE_TOOLS=1`."""
    import pytest  # programs that use this file do without

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


def find_tool(name: str) -> str:
    """Return the path of a program, of this environment or on `PATH`."""
    return shutil.which(name, path=str(Path(sys.executable).parent)) or shutil.which(name) or missing_tool(name)


def ran(*command: object, cwd: Path = ROOT, **variables: str) -> "subprocess.CompletedProcess[str]":
    """Run a program to its end, with this checkout on the path of Python."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **variables}
    words = list(map(str, command))
    nothing = subprocess.DEVNULL
    return subprocess.run(words, cwd=cwd, env=environment, stdin=nothing, capture_output=True, text=True, check=False)


def tracked(*folders: str) -> list[str]:
    """The files that Git knows, by their names, as far as they are there."""
    listed = subprocess.run(["git", "ls-files", "-z", *folders], cwd=ROOT, capture_output=True, text=True, check=True)
    return [name for name in listed.stdout.split("\0") if (ROOT / name).is_file()]


@contextmanager
def limited(kind: int, most: int) -> Generator[None, None, None]:
    """A limit of `resource` for this process, such as RLIMIT_FSIZE, for the time of the block."""
    import resource  # not on every system

    before = resource.getrlimit(kind)
    resource.setrlimit(kind, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(kind, before)


def eventually(holds: Callable[[], object], told: Callable[[], str] = lambda: "") -> None:
    """Wait until a condition is true, for at most `PATIENCE`.

    Args:
        holds: The condition.
        told: Returns the message of a failure.
    """
    deadline = time.monotonic() + PATIENCE
    while not holds():
        assert time.monotonic() < deadline, f"timed out: {told()}"
        time.sleep(0.02)


def is_taken(port: int) -> bool:
    """Whether a program of this machine listens on a port."""
    with socket.socket() as asking:
        return asking.connect_ex(("127.0.0.1", port)) == 0


def reserved_port() -> int:
    """Return a port for a server of the tests, reserved as long as this process lives.

    It is bound but not listened on: the kernel gives it to no other process, and a server that names it can listen on
    it (with SO_REUSEADDR).
    """
    sock = socket.socket()
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind(("127.0.0.1", 0))
    atexit.register(sock.close)
    return sock.getsockname()[1]


if __name__ == "__main__":
    for version in sys.argv[1:]:
        if found := path_of_python(version):
            print(found)
            sys.exit()
        print(f"not run: no Python {version} here, neither on the path nor below ~/.pyenv", file=sys.stderr)
    sys.exit(1)
