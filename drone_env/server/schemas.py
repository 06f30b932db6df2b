"""The requests that fly, and OpenEnv's messages, as Pydantic models."""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, cast

from pydantic import BeforeValidator, ConfigDict, Field, JsonValue, model_validator
from typing_extensions import Self

from drone_env.core.actions import N_ACTIONS, Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE, REWARD_PROFILES
from drone_env.errors import InvalidValueError
from drone_env.flights.provenance import AgentLabel
from drone_env.llm.answers import Answer, actions_named, read_answer
from drone_env.models import MAX_SEED, DroneAction, DroneObservation, Seed, StrictModel

RESETS: list[JsonValue] = [{"task_name": "easy_delivery", "seed": 7}, {}, {"episode_id": "run-1", "seed": 7}]
ENV_NAME = "drone-env"
DESCRIPTION = (
    "A drone delivers parcels on a generated city grid, on one battery, in as few steps as possible. Maps are solved "
    "exactly, so every score can be compared with the optimum of its map."
)
OPENENV_PROFILE = "score"
"""The default of OpenEnv sessions: trainers log the sum of the rewards or the last one, and both are the score."""
MAX_ROUTE = 1000
"""Maximum number of actions in one step of an OpenEnv session; the longest task has 640 steps."""


def examples(values: list[JsonValue]) -> Any:
    """Return the OpenAPI examples of a body."""
    return {str(value): {"value": value} for value in values}


class ResetOptions(StrictModel):
    """Options of a reset."""

    model_config = ConfigDict(json_schema_extra={"examples": RESETS})
    default_profile: ClassVar[str] = ORIGINAL_PROFILE

    task_name: str | None = Field(default=None, max_length=100, description="Id, short name or grader of the task.")
    seed: Seed | None = Field(
        default=None,
        description="Number of the map. Default: the next on a fixed walk; in a new session, a random one.",
    )
    reward_profile: str | None = Field(
        default=None,
        max_length=100,
        description=f"Reward profile: {', '.join(REWARD_PROFILES)}. Default: `{ORIGINAL_PROFILE}`; in OpenEnv sessions "
        f"`{OPENENV_PROFILE}`.",
    )
    agent: AgentLabel | None = Field(default=None, description="Name of the agent in the records: one printable line.")
    episode_id: str | None = Field(default=None, max_length=255, description="Id of the episode in OpenEnv's state.")
    split: str | None = Field(
        default=None,
        max_length=100,
        description="Split of a task, such as `easy_delivery/test`; replaces task_name and seed.",
    )
    index: int | None = Field(default=None, ge=0, le=MAX_SEED, description="Number of the map within the split.")

    @model_validator(mode="after")
    def _check_split(self) -> Self:
        if (self.split is None) != (self.index is None):
            raise ValueError("split and index go together")
        if self.split is not None and (self.task_name is not None or self.seed is not None):
            raise ValueError("split and index choose a map; leave out task_name and seed")
        return self


class SessionReset(ResetOptions):
    """Options of a reset in an OpenEnv session."""

    default_profile: ClassVar[str] = OPENENV_PROFILE


class OpenEnvReset(SessionReset):
    """Options of a reset over `/ws`."""

    # Names of the package alone: a caller must not read files.
    prompt: str | None = Field(
        default=None,
        pattern=r"^[a-z0-9-]{1,40}$",
        description="A prompt of `drone-env infer`, such as `minimal`, whose text each observation contains.",
    )


class WireAction(DroneAction):
    """One action in OpenEnv's format."""

    metadata: dict[str, Any] = Field(default_factory=dict[str, Any], description="Ignored.")


def route_text(value: object) -> str:
    """Return the names of the actions of a route, separated by spaces.

    Args:
        value: A number, a word, a text with several words, or a list of numbers and words.

    Raises:
        ValueError: if it is anything else, empty, or longer than `MAX_ROUTE`.
    """
    if isinstance(value, str):
        if value in Action.__members__:
            return value
        reading = read_answer(Answer(text=value), plan=True)
        if reading.kind != "ok":
            raise ValueError(f"{reading.reason}; actions: {', '.join(Action.__members__)}")
        value = [action.name for action in reading.actions]
    words = cast(list[object], value) if isinstance(value, list) else [value]
    if not 0 < len(words) <= MAX_ROUTE:
        raise ValueError(f"a route has 1 to {MAX_ROUTE} actions, got {len(words)}")
    names = [Action(word).name if type(word) is int and 0 <= word < N_ACTIONS else word for word in words]
    try:
        return " ".join([action.name for action in actions_named(names)])
    except InvalidValueError as error:
        raise ValueError(f"{error}; actions: {', '.join(Action.__members__)}, or 0 to {N_ACTIONS - 1}") from None


Route = Annotated[str, BeforeValidator(route_text)]
"""Names of actions, separated by spaces; numbers and lists are converted."""


class RouteAction(StrictModel):
    """An action, or several in a row, in an OpenEnv session.

    `{"direction": "UP"}`, `{"direction": 0}`, `{"direction": "UP UP WAIT"}`, `{"route": ["UP", "UP", "WAIT"]}`.
    """

    direction: Route = Field(
        description=f"One of {', '.join(Action.__members__)}, or up to {MAX_ROUTE} of them, separated by spaces."
    )
    metadata: dict[str, Any] = Field(default_factory=dict[str, Any], description="Ignored.")

    @model_validator(mode="before")
    @classmethod
    def _rename(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            return {"direction": data}
        fields = cast(dict[str, Any], data)
        named = "route" if "route" in fields and "direction" not in fields else "direction"
        return {"direction" if key == named else key: value for key, value in fields.items()}


def fly_route(route: str, episode: Episode, step: Callable[[Action], float]) -> tuple[float, int]:
    """Fly actions until the episode ends; those after the end are not flown.

    Args:
        route: The names of the actions, separated by spaces.
        episode: The episode.
        step: Flies one action and returns its reward.

    Returns:
        The sum of the rewards, and the number of actions flown.
    """
    before, rewards = episode.steps, list[float]()
    for name in route.split():
        rewards.append(step(Action[name]))
        if episode.ended:
            break
    return sum(rewards), episode.steps - before


class WireObservation(DroneObservation):
    """An observation with OpenEnv's fields."""

    reward: float | None = Field(default=None, description="Sum of the rewards of the step; null after a reset.")
    prompt: str = Field(default="", description="Rules and observation as text, if the reset named a prompt.")
    metadata: dict[str, Any] = Field(
        default_factory=dict[str, Any],
        description="`reward_profile`, which pays; after a step also `flown`, the number of actions flown.",
    )
