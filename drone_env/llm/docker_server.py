"""This project's server in a Docker container."""

import shutil
import subprocess
import time
from collections.abc import Generator
from contextlib import contextmanager

import httpx

from drone_env.errors import InvalidValueError

START_SECONDS = 120.0
PORT = 8000


@contextmanager
def running_image(image: str) -> Generator[str, None, None]:
    """The address of a container of an image of this project's server, which ends with the `with`."""
    if shutil.which("docker") is None:
        raise InvalidValueError("--use-image needs Docker, which is not installed")
    container = _docker("run", "--detach", "--rm", "--publish", f"127.0.0.1::{PORT}", image)
    try:
        url = f"http://{_docker('port', container, str(PORT)).splitlines()[0]}"
        _wait(url, image)
        yield url
    finally:
        _docker("rm", "--force", container)


def _docker(*arguments: str) -> str:
    done = subprocess.run(["docker", *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InvalidValueError(f"docker {arguments[0]} failed: {done.stderr.strip()}")
    return done.stdout.strip()


def _wait(url: str, image: str) -> None:
    deadline = time.monotonic() + START_SECONDS
    while True:
        try:
            if httpx.get(f"{url}/health", timeout=5).status_code == 200:
                return
        except httpx.HTTPError:
            pass  # The server is still starting.
        if time.monotonic() > deadline:
            raise InvalidValueError(f"the server of the image {image} does not respond within {START_SECONDS:g} s")
        time.sleep(0.2)
