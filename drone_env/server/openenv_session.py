"""A session of OpenEnv's clients: what `/ws` and `/mcp` fly."""

import asyncio
import uuid
from collections.abc import Callable
from typing import Any

from drone_env.core.episode import NOT_STARTED, Episode
from drone_env.errors import EpisodeError
from drone_env.flights.flight import new_id
from drone_env.flights.provenance import Provenance
from drone_env.flights.sessions import ANONYMOUS, Session
from drone_env.llm.answers import way_to
from drone_env.llm.prompt import Prompt, get_prompt, ways_of
from drone_env.llm.text_episode import status_text
from drone_env.models import openenv_json
from drone_env.server.schemas import OpenEnvReset, SessionReset, fly_route
from drone_env.server.state import AppState
from drone_env.server.task_api import start_episode


def full_text(prompt: Prompt, episode: Episode) -> str:
    """Return the text of a prompt: the rules of the task, and the observation."""
    return "\n\n".join(message["content"] for message in prompt.messages(episode))


def flown_text(episode: Episode, flown: int) -> str:
    """Return the text after a step: what happened, and where the drone is now."""
    return f"Flown: {flown}. {episode.message} Step: {episode.steps}. {status_text(episode)}"


def openenv_fields(episode: Episode, prompt: Prompt | None, metadata: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a `WireObservation` that no `DroneObservation` has, without `reward`.

    Args:
        episode: The episode.
        prompt: The prompt of the reset.
        metadata: Further fields of `metadata`.
    """
    return {
        "prompt": "" if prompt is None else full_text(prompt, episode),
        "metadata": {"reward_profile": episode.reward_profile.id, **metadata},
    }


class OpenEnvSession:
    """A session in memory, or a stored one that all server processes share. One request at a time uses it.

    Args:
        app_state: The parts of the server.
        stored: Id of the stored session; None for one in memory, which starts with its first reset.
    """

    def __init__(self, app_state: AppState, stored: str | None = None) -> None:
        self._app_state = app_state
        self._stored = stored
        self._session: Session | None = None
        self._prompt: Prompt | None = None
        self.episode_id = str(uuid.uuid4())
        """The id from the last reset."""

    async def reset(self, options: SessionReset) -> Episode:
        """Start an episode and return it. After an error the current one continues.

        Raises:
            UnknownNameError, InvalidValueError: if there is no such map, profile or prompt.
        """
        named = options.prompt if isinstance(options, OpenEnvReset) else None
        # Reading a prompt loads Jinja, which takes 0.1 s.
        prompt = None if named is None else await asyncio.to_thread(get_prompt, named)
        agent = options.agent or ANONYMOUS
        if self._stored is None:
            last = None if self._session is None else self._session.episode.seed
            # Reading a drawn map takes milliseconds.
            episode = await asyncio.to_thread(start_episode, options, last)
            self._session = Session(new_id(), episode, Provenance.of(agent))
        else:
            episode = await self._use(
                lambda session: session.begin(start_episode(options, session.episode.seed), agent)
            )
        self.episode_id = str(uuid.uuid4()) if options.episode_id is None else options.episode_id
        self._prompt = prompt
        return episode

    async def fly(self, route: str) -> tuple[Episode, float, int]:
        """Fly a route; returns the episode, the sum of the rewards, and the number of steps.

        Raises:
            EpisodeError: before the first reset.
        """
        flown = 0.0, 0

        def fly(session: Session) -> None:
            nonlocal flown
            flown = fly_route(route, session.episode, session.fly)

        return await self._use(fly), *flown

    async def goto(self, stop: str) -> tuple[Episode, float, int]:
        """Fly to a stop; returns and raises as `fly`.

        Raises:
            InvalidValueError: if the stop is not in reach.
        """
        ways = await asyncio.to_thread(ways_of, (await self.look()).copy())
        return await self.fly(" ".join(action.name for action in way_to(stop, ways)))

    async def look(self) -> Episode:
        """Return the episode.

        Raises:
            EpisodeError: before the first reset.
        """
        return await self._use(lambda _: None)

    async def observation(self, episode: Episode, reward: float | None, **metadata: int) -> str:
        """Return an observation as JSON in OpenEnv's format, with the text that the reset named."""
        if self._prompt is None:
            fields = openenv_fields(episode, None, metadata)
        else:  # takes milliseconds, and some prompts compile code
            fields = await asyncio.to_thread(openenv_fields, episode, self._prompt, metadata)
        return openenv_json(episode, reward, **fields).decode()

    async def _use(self, change: Callable[[Session], object]) -> Episode:
        """Call a function with the session, store what ended, and return the episode."""
        app_state = self._app_state
        if self._stored is not None:
            return await app_state.write(self._use_stored, self._stored, change)
        if self._session is None:
            raise EpisodeError(NOT_STARTED)
        change(self._session)
        if self._session.has_ended:
            flown = self._session.episode, self._session.provenance, self._session.flight_id
            await app_state.write(app_state.store.add_episode, *flown)
            self._session.unstored = ""
        return self._session.episode

    def _use_stored(self, stored: str, change: Callable[[Session], object]) -> Episode:
        def use(session: Session) -> Episode:
            change(session)
            return session.episode.copy()

        return self._app_state.sessions.use(stored, use)
