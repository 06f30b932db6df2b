"""The requests that fly, and OpenEnv's messages, as Pydantic models."""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, ConfigDict, Field, JsonValue, model_validator
from typing_extensions import Self

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.rewards import ORIGINAL_PROFILE, REWARD_PROFILES
from drone_env.flights.provenance import AgentLabel
from drone_env.llm.answers import Answer, read_answer
from drone_env.models import MAX_SEED, DroneObservation, Seed, StrictModel

RESETS: list[JsonValue] = [{"task_name": "easy_delivery", "seed": 7}, {}]
ENV_NAME = "drone-env"
DESCRIPTION = (
    "A drone delivers parcels on a generated city grid, on one battery, in as few steps as possible. Maps are solved "
    "exactly, so every score can be compared with the optimum of its map."
)
OPENENV_PROFILE = "score"
"""The default of OpenEnv sessions: trainers log the sum of the rewards or the last one, and both are the score."""
MAX_ROUTE = 1000
"""Maximum number of actions in one step of an OpenEnv session; the longest task has 640 steps."""


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

    episode_id: str | None = Field(default=None, max_length=255, description="Id of the episode in OpenEnv's state.")


class OpenEnvReset(SessionReset):
    """Options of a reset over `/ws`."""

    # Names of the package alone: a caller must not read files.
    prompt: str | None = Field(
        default=None,
        pattern=r"^[a-z0-9-]{1,40}$",
        description="A prompt of `drone-env infer`, such as `minimal`, whose text each observation contains.",
    )


def route_text(text: str) -> str:
    """Return the names of the actions of a route, separated by spaces.

    Raises:
        ValueError: if a word is not an action, there is none, or there are more than `MAX_ROUTE`.
    """
    if text in Action.__members__:
        return text
    reading = read_answer(Answer(text=text), plan=True)
    if reading.kind != "ok":
        raise ValueError(f"{reading.reason}; actions: {', '.join(Action.__members__)}")
    if len(reading.actions) > MAX_ROUTE:
        raise ValueError(f"a route has 1 to {MAX_ROUTE} actions, got {len(reading.actions)}")
    return " ".join([action.name for action in reading.actions])


Route = Annotated[str, AfterValidator(route_text)]
"""Names of actions, separated by spaces."""


class RouteAction(StrictModel):
    """An action, or several in a row, in an OpenEnv session: `{"direction": "UP"}`, `{"direction": "UP UP WAIT"}`."""

    direction: Route = Field(
        description=f"One of {', '.join(Action.__members__)}, or up to {MAX_ROUTE} of them, separated by spaces."
    )
    metadata: dict[str, Any] = Field(default_factory=dict[str, Any], description="Ignored.")


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
