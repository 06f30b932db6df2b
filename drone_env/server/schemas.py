"""The requests that fly, and OpenEnv's messages, as Pydantic models."""

from typing import Annotated, Any

from pydantic import AfterValidator, ConfigDict, Field, JsonValue, model_validator
from typing_extensions import Self

from drone_env.core.rewards import ORIGINAL_PROFILE, REWARD_PROFILES
from drone_env.models import MAX_SEED, DroneAction, DroneObservation, Message, Seed
from drone_env.results.finished import check_agent

RESETS: list[JsonValue] = [{"task_name": "easy_delivery", "seed": 7}, {}, {"episode_id": "run-1", "seed": 7}]
ENV_NAME = "drone-env"
DESCRIPTION = (
    "A drone delivers parcels on a generated city grid, on one battery, in as few steps as possible. Maps are solved "
    "exactly, so every score can be compared with the optimum of its map."
)


def examples(values: list[JsonValue]) -> Any:
    """Return the OpenAPI examples of a body."""
    return {str(value): {"value": value} for value in values}


# Checked here, because the store checks it again when the episode has ended.
AgentName = Annotated[str, Field(min_length=1, max_length=200), AfterValidator(check_agent)]


class ResetOptions(Message):
    """Options of a reset."""

    model_config = ConfigDict(json_schema_extra={"examples": RESETS})

    task_name: str | None = Field(default=None, max_length=100, description="Id, short name or grader of the task.")
    seed: Seed | None = Field(
        default=None,
        description="Number of the map. Default: the next on a fixed walk; in a new session, a random one.",
    )
    reward_profile: str | None = Field(
        default=None,
        max_length=100,
        description=f"Reward profile: {', '.join(REWARD_PROFILES)}. Default: `{ORIGINAL_PROFILE}`.",
    )
    agent: AgentName | None = Field(default=None, description="Name of the agent in the records: one printable line.")
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


class WireAction(DroneAction):
    """One action in OpenEnv's format."""

    metadata: dict[str, Any] = Field(default_factory=dict[str, Any], description="Ignored.")


class WireObservation(DroneObservation):
    """An observation with OpenEnv's fields."""

    reward: float | None = Field(default=None, description="Reward of the step; null after a reset.")
    metadata: dict[str, Any] = Field(default_factory=dict[str, Any], description="Empty.")
