"""The environment as a subclass of OpenEnv's `Environment`, for use in a process or with OpenEnv's server.

    from openenv.core.env_server import create_fastapi_app

    app = create_fastapi_app(
        DroneDeliveryEnvironment, DroneEnvAction, DroneEnvObservation, max_concurrent_envs=64, state_cls=DroneEnvState
    )

Importing this module imports OpenEnv's server package, which takes seconds.
"""

import uuid
from typing import Any

from openenv.core.env_server.interfaces import Environment
from openenv.core.env_server.types import Action, EnvironmentMetadata, Observation, State
from openenv.core.rubrics import Rubric
from pydantic import ConfigDict, ValidationError

from drone_env import __version__
from drone_env.core.episode import Episode
from drone_env.errors import InvalidValueError, text_of
from drone_env.llm.prompt import Prompt, get_prompt
from drone_env.models import DroneState, observation_fields
from drone_env.server.openenv_session import openenv_fields
from drone_env.server.schemas import DESCRIPTION, ENV_NAME, OpenEnvReset, RouteAction, WireObservation, fly_route
from drone_env.server.task_api import DEFAULT_TASK, TaskApi, start_episode


class DroneEnvAction(RouteAction, Action):
    """One action, or several in a row, as an OpenEnv `Action`."""

    model_config = ConfigDict(frozen=False)


class DroneEnvObservation(WireObservation, Observation):
    """One observation as an OpenEnv `Observation`."""

    model_config = ConfigDict(frozen=False)


class DroneEnvState(DroneState, State):
    """The full state as an OpenEnv `State`."""

    model_config = ConfigDict(frozen=False, extra="forbid")


class GradeRubric(Rubric):
    """The graded score of the episode; provisional until it has ended."""

    def forward(self, action: Any, observation: Any) -> float:
        """Return the score of the observation."""
        return observation.score


class DroneDeliveryEnvironment(TaskApi, Environment[DroneEnvAction, DroneEnvObservation, DroneEnvState]):
    """One episode at a time. Rewards come from the reward profile; `rubric` is the grader.

    Args:
        task: The default task of a reset.

    Raises:
        UnknownNameError: if there is no such task.
    """

    SUPPORTS_CONCURRENT_SESSIONS = True

    def __init__(self, task: str = DEFAULT_TASK) -> None:
        super().__init__(rubric=GradeRubric())
        self._task, self._episode = task, Episode(task)
        self._episode_id = ""
        self._prompt: Prompt | None = None

    def reset(self, seed: int | None = None, episode_id: str | None = None, **kwargs: Any) -> DroneEnvObservation:
        """Start an episode. After an error the current one continues.

        Args:
            seed: Number of the map, 0 to 2^53 - 1. Default: the next on a fixed walk, and at first a random map of the
                train split.
            episode_id: Id of the episode in the state; default: a random one.
            kwargs: `task_name`, `reward_profile`, `prompt`, `agent`, or `split` and `index` of the task API.

        Raises:
            InvalidValueError: if an option is unknown or not allowed.
            UnknownNameError: if there is no such task, profile, prompt or split.
        """
        try:
            options = OpenEnvReset(seed=seed, episode_id=episode_id, **kwargs)
        except ValidationError as error:
            raise InvalidValueError(text_of(error)) from None
        last = self._episode.seed if self._episode.started else None
        prompt = None if options.prompt is None else get_prompt(options.prompt)
        self._episode, self._prompt = start_episode(options, last, self._task), prompt
        self._episode_id = options.episode_id if options.episode_id is not None else str(uuid.uuid4())
        self._reset_rubric()
        return self._observe(None, {})

    def step(self, action: DroneEnvAction, timeout_s: float | None = None, **kwargs: Any) -> DroneEnvObservation:
        """Fly an action or a route. After the end of the episode nothing changes and nothing pays.

        Args:
            action: The action.
            timeout_s: Ignored.
            kwargs: Ignored.

        Raises:
            EpisodeError: before the first reset.
        """
        reward, flown = fly_route(action.direction, self._episode, self._episode.step)
        observation = self._observe(reward, {"flown": flown})
        self._apply_rubric(action, observation)
        return observation

    @property
    def state(self) -> DroneEnvState:
        """The full state of the episode."""
        return DroneEnvState.of(self._episode, self._episode_id)

    def get_metadata(self) -> EnvironmentMetadata:
        """Return name, description and version."""
        return EnvironmentMetadata(name=ENV_NAME, description=DESCRIPTION, version=__version__)

    def _observe(self, reward: float | None, metadata: dict[str, Any]) -> DroneEnvObservation:
        # The fields come from the rules, so validation is not needed.
        return DroneEnvObservation.model_construct(
            **observation_fields(self._episode),
            **openenv_fields(self._episode, self._prompt, metadata),
            reward=reward,
        )
