"""Flying in a server, such as one in a Docker image, beside the rules here: the two must agree in every observation."""

import asyncio
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any

import httpx

from drone_env.client import DroneEnvClient, ServerError
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.errors import InvalidValueError
from drone_env.models import DroneObservation

START_SECONDS = 120.0
PORT = 8000


class ServerSession:
    """A session on a server that flies, step by step, what an episode here flies. To be closed.

    Args:
        url: Where the server is.
        agent: Who flies, for its records.
    """

    def __init__(self, url: str, agent: str) -> None:
        self._url = url
        self._agent = agent
        self._client = DroneEnvClient(url)

    async def reset(self, episode: Episode) -> None:
        """Start the map of an episode that has just been reset.

        Raises:
            InvalidValueError: if the server shows something else than the episode, or does not answer.
        """
        profile = episode.reward_profile.id
        await self._agree(episode, self._client.reset, episode.task.id, episode.seed, profile, self._agent)

    async def step(self, episode: Episode, action: Action) -> None:
        """Fly the action that the episode has just flown."""
        await self._agree(episode, self._client.step, action.name)

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    async def _agree(self, episode: Episode, call: Callable[..., dict[str, Any]], *arguments: object) -> None:
        try:
            shown = await asyncio.to_thread(call, *arguments)
        except (ServerError, httpx.HTTPError) as error:
            raise InvalidValueError(f"the server at {self._url} did not fly: {error}") from None
        expected = json.loads(DroneObservation.of(episode).model_dump_json())
        differing = sorted(name for name in expected if shown.get(name) != expected[name])
        if differing:
            raise InvalidValueError(
                f"the server at {self._url} flies by other rules: map {episode.seed}, step {episode.steps}: "
                f"{differing[0]} {shown.get(differing[0])!r} where it is {expected[differing[0]]!r} here"
            )


@contextmanager
def running_image(image: str) -> Generator[str, None, None]:
    """The address of a container of an image of this project's server, which ends with the `with`.

    Raises:
        InvalidValueError: if Docker is missing, the image does not start, or its server does not answer within 120 s.
    """
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
            pass  # it is still starting, until the time is over
        if time.monotonic() > deadline:
            raise InvalidValueError(f"the server of the image {image} does not answer within {START_SECONDS:g} s")
        time.sleep(0.2)
