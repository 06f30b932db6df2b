"""A server, such as one in a Docker image, that repeats the flights; its observations must equal those here."""

import asyncio
import json
import shutil
import subprocess
import time
from collections.abc import Awaitable, Callable, Generator
from contextlib import closing, contextmanager

import httpx

from drone_env.client import DroneEnvClient, ServerError
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.errors import InvalidValueError
from drone_env.models import DroneObservation

START_SECONDS = 120.0
PORT = 8000


@contextmanager
def following(server: str | None, agent: str) -> Generator[Callable[[Episode], Awaitable[None]] | None, None, None]:
    """A function that repeats the new steps of an episode on a server; None without a server.

    Args:
        server: The address of the server.
        agent: The agent in its records.

    The function raises `InvalidValueError` if an observation of the server differs, or the server fails.
    """
    if server is None:
        yield None
        return
    repeated: list[Episode] = []
    with closing(DroneEnvClient(server)) as client:

        async def follow(episode: Episode) -> None:
            try:
                if not repeated:
                    repeated.append(Episode(episode.task, episode.reward_profile, episode.seed))
                    start = (episode.task.id, episode.seed, episode.reward_profile.id, agent)
                    compare(await asyncio.to_thread(client.reset, *start))
                for action in map(Action, episode.actions[repeated[0].steps :]):
                    repeated[0].step(action)
                    compare(await asyncio.to_thread(client.step, action.name))
            except (ServerError, httpx.HTTPError) as error:
                raise InvalidValueError(f"the server at {server} failed: {error}") from None

        def compare(found: dict[str, object]) -> None:
            (episode,) = repeated
            expected = json.loads(DroneObservation.of(episode).model_dump_json())
            differing = sorted(name for name in expected if found.get(name) != expected[name])
            if differing:
                raise InvalidValueError(
                    f"the server at {server} has other rules: map {episode.seed}, step {episode.steps}: "
                    f"{differing[0]} is {found.get(differing[0])!r}, must be {expected[differing[0]]!r}"
                )

        yield follow


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
