"""Flights repeated on a server, also in a Docker container, whose observations must equal those here."""

import json
import shutil
import subprocess
import time
from collections.abc import Generator
from contextlib import contextmanager

import httpx

from drone_env.client import DroneEnvClient, ServerError
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.errors import InvalidValueError
from drone_env.models import DroneObservation

START_SECONDS = 120.0
PORT = 8000


def repeat_on_server(server: str, episode: Episode, agent: str) -> None:
    """Fly the steps of an episode on a server too.

    Args:
        server: Its address.
        episode: The episode.
        agent: The agent in the records of the server.

    Raises:
        InvalidValueError: if an observation of the server differs, or the server fails.
    """
    here = Episode(episode.task, episode.reward_profile, episode.seed)
    try:
        with DroneEnvClient(server) as client:
            _compare(client.reset(here.task.id, here.seed, here.reward_profile.id, agent), here, server)
            for action in map(Action, episode.actions):
                here.step(action)
                _compare(client.step(action.name), here, server)
    except (ServerError, httpx.HTTPError) as error:
        raise InvalidValueError(f"the server at {server} failed: {error}") from None


def _compare(found: dict[str, object], here: Episode, server: str) -> None:
    expected = json.loads(DroneObservation.of(here).model_dump_json())
    for name in sorted(expected):
        if found.get(name) != expected[name]:
            raise InvalidValueError(
                f"the server at {server} has other rules: map {here.seed}, step {here.steps}: "
                f"{name} is {found.get(name)!r}, must be {expected[name]!r}"
            )


@contextmanager
def running_image(image: str) -> Generator[str, None, None]:
    """The address of a container of an image of this project's server, which ends with the `with`."""
    if shutil.which("docker") is None:
        raise InvalidValueError("--use-image needs Docker, which is not installed")
    container = _docker("run", "--detach", "--rm", "--publish", f"127.0.0.1::{PORT}", image)
    try:
        url = f"http://{_docker('port', container, str(PORT)).splitlines()[0]}"
        deadline = time.monotonic() + START_SECONDS
        while not _responds(url):
            if time.monotonic() > deadline:
                raise InvalidValueError(f"the server of the image {image} does not respond within {START_SECONDS:g} s")
            time.sleep(0.2)
        yield url
    finally:
        _docker("rm", "--force", container)


def _docker(*arguments: str) -> str:
    done = subprocess.run(["docker", *arguments], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise InvalidValueError(f"docker {arguments[0]} failed: {done.stderr.strip()}")
    return done.stdout.strip()


def _responds(url: str) -> bool:
    try:
        return httpx.get(f"{url}/health", timeout=5).is_success
    except httpx.HTTPError:
        return False
