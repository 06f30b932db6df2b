"""Follow flights on a server, whose observations must equal those here."""

import asyncio
import json
from collections.abc import Awaitable, Callable, Generator
from contextlib import closing, contextmanager

import httpx

from drone_env.client import DroneEnvClient, ServerError
from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.errors import InvalidValueError
from drone_env.models import DroneObservation


@contextmanager
def following(server: str, agent: str) -> Generator[Callable[[Episode], Awaitable[None]], None, None]:
    """A function that repeats the new steps of an episode on a server.

    Args:
        server: The address of the server.
        agent: The agent in its records.

    The function raises `InvalidValueError` if an observation of the server differs, or the server fails.
    """
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
