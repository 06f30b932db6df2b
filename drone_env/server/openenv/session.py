"""One OpenEnv session: an episode, the name that its client gave it, and what the wire carries of it."""

import secrets
import uuid
from functools import lru_cache
from typing import Any, NamedTuple

from pydantic_core import to_json

from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE, RewardProfile, get_reward_profile
from drone_env.core.seeds import SPLITS, next_seed
from drone_env.core.tasks import TaskConfig, get_task
from drone_env.errors import InvalidValueError
from drone_env.models import LEGEND, DroneState, map_lines, observation_numbers, shown
from drone_env.server.openenv.task_api import find_map
from drone_env.server.schemas import ResetOptions

ENV_NAME = "drone-env"
DESCRIPTION = (
    "A drone delivers parcels on a generated city grid, on one battery, in as few steps as possible. Maps are solved "
    "exactly, so every score stands beside the optimum of its map."
)
DEFAULT_TASK = "easy_delivery"


def _json(value: object) -> str:
    return to_json(value).decode()


LEGEND_JSON = _json(LEGEND)


@lru_cache(maxsize=1 << 14)  # 256 hard maps have 4,608 lines
def _line_json(line: bytes) -> tuple[str, str]:
    emoji, names = shown(line)
    return _json(emoji), _json(names)


class Start(NamedTuple):
    """Which map to fly, and what steps pay."""

    task: TaskConfig
    seed: int
    reward_profile: RewardProfile


def start_of(options: ResetOptions, last_seed: int | None, task: str = DEFAULT_TASK) -> Start:
    """What a reset asks for.

    Args:
        options: The reset.
        last_seed: The map that the session flew last: without a seed, the next on the walk follows. None for a new
            session, whose first map is drawn at random from the train split.
        task: The task where the reset names none.

    Raises:
        UnknownNameError: if there is no such task, profile or split.
        InvalidValueError: if the split has no such map.
    """
    profile = get_reward_profile(options.reward_profile or ORIGINAL_PROFILE)
    if options.split is not None and options.index is not None:
        try:
            return Start(*find_map(options.split, options.index), profile)
        except IndexError as error:
            raise InvalidValueError(str(error)) from None
    seed = options.seed
    if seed is None:
        seed = secrets.randbelow(SPLITS["train"].stop) if last_seed is None else next_seed(last_seed)
    return Start(get_task(options.task_name or task), seed, profile)


class Flight:
    """One session. Before the first reset `step` and the readers raise `EpisodeError`.

    Args:
        task: The task of a reset that names none.

    Raises:
        UnknownNameError: if there is no such task.
    """

    def __init__(self, task: str = DEFAULT_TASK) -> None:
        self.default_task = task
        self.episode = Episode(task)
        self.episode_id: str | None = None
        self.agent: str | None = None
        self.stored = False
        """Whether the episode, once ended, is in the store."""

    def reset(self, options: ResetOptions) -> None:
        """Start an episode. On an error the running one is left as it was.

        Raises:
            UnknownNameError: if there is no such task, profile or split.
            InvalidValueError: if the split has no such map.
        """
        last = self.episode.seed if self.episode.started else None
        start = start_of(options, last, self.default_task)
        if start.task != self.episode.task:
            self.episode = Episode(start.task, start.reward_profile)
        self.episode.reset(start.seed, start.reward_profile)
        self.episode_id = options.episode_id if options.episode_id is not None else str(uuid.uuid4())
        self.agent = options.agent
        self.stored = False

    def result(self, reward: float | None) -> str:
        """The JSON of the episode now, with what the last step paid (None after a reset)."""
        return openenv_json(self.episode, reward)

    def state(self) -> str:
        """The JSON of the full state as OpenEnv sends it."""
        return _json({**DroneState.of(self.episode).model_dump(), "episode_id": self.episode_id})


def flat_json(episode: Episode, _: float | None = None) -> str:
    """The JSON of `DroneObservation.of(episode)`."""
    return _observation_json(episode, observation_numbers(episode)) + "}"


def openenv_json(episode: Episode, reward: float | None) -> str:
    """The same as OpenEnv sends it: reward and done beside the rest.

    Args:
        episode: The episode.
        reward: What the last step paid, None after a reset.
    """
    numbers = observation_numbers(episode)
    done = numbers.pop("done")
    observation = _observation_json(episode, numbers)
    return f'{{"observation":{observation},"metadata":{{}}}},"reward":{_json(reward)},"done":{_json(done)}}}'


def _observation_json(episode: Episode, numbers: dict[str, Any]) -> str:
    """The JSON of an observation, without the brace at its end.

    Put together from the JSON of the map's lines, of which a step changes one or two: a third of a step's time.
    """
    lines = [_line_json(line) for line in map_lines(episode)]
    grid, cell_types = (",".join([line[i] for line in lines]) for i in (0, 1))
    return f'{{"grid":[{grid}],"cell_types":[{cell_types}],{_json(numbers)[1:-1]},"legend":{LEGEND_JSON}'
