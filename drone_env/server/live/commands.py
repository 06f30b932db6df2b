"""The commands of the page: each is one JSON object with a `type`."""

from typing import Annotated, Any, Literal, cast

from pydantic import AfterValidator, Field, TypeAdapter, ValidationError, model_validator
from typing_extensions import Self

from drone_env.core.tasks import MAX_UNITS
from drone_env.errors import InvalidValueError, text_of
from drone_env.flights.provenance import PersonName, Provenance
from drone_env.models import MAX_SEED, Count, Direction, Seed, StrictModel
from drone_env.server.json_routes import SMALL, parse_json
from drone_env.server.pilots import check_name
from drone_env.server.state import LONGEST_ID

MOST_EPISODES = 8


RequestNumber = Annotated[int | None, Field(ge=0, le=MAX_SEED, description="The response contains it.")]
PilotName = Annotated[str, Field(max_length=100)]
FlightNumber = Annotated[int, Field(ge=0, lt=MOST_EPISODES)]
Topic = Literal["requests", "training", "episodes"]


class Fork(StrictModel):
    """A step of a flight, and the actions from there on."""

    actions: list[Direction] = Field(max_length=MAX_UNITS, fail_fast=True, description="All actions from the start.")
    step: Count = Field(description="Number of actions that belong to the first flight; 0 for your own flight.")
    of: Provenance = Field(description="Who flew that flight.")

    @model_validator(mode="after")
    def _step_is_there(self) -> Self:
        if self.step > len(self.actions):
            raise ValueError(f"a fork from step {self.step} requires as many actions, got {len(self.actions)}")
        return self


class Start(StrictModel):
    """Fly one map with one to eight pilots, and end the current flights.

    With a fork, the last pilot (or the person, if the fork's step is 0) starts after the fork's actions. The agents
    start after as many steps of their own, or with a greater `step` after that many.
    """

    type: Literal["start"]
    task: str = Field(max_length=100)
    pilots: list[PilotName] = Field(min_length=1, max_length=MOST_EPISODES)
    seed: Seed | None = None
    reward_profile: str | None = Field(default=None, max_length=100)
    fork: Fork | None = None
    step: int = Field(default=0, ge=0, le=MAX_UNITS)
    name: Annotated[PersonName, AfterValidator(check_name)] | None = Field(
        default=None, description="The person's name."
    )
    number: RequestNumber = None

    @model_validator(mode="after")
    def _fork_has_a_map(self) -> Self:
        if self.fork is not None and self.seed is None:
            raise ValueError("a fork needs the seed of its map")
        return self


class Attach(StrictModel):
    """Continue flights after a lost connection."""

    type: Literal["attach"]
    sessions: list[Annotated[str, Field(max_length=LONGEST_ID)]] = Field(min_length=1, max_length=MOST_EPISODES)
    number: RequestNumber = None


class Play(StrictModel):
    """Fly the agents continuously."""

    type: Literal["play"]
    speed: float | None = Field(default=None, ge=0.5, le=60, description="Steps per second.")


class Plain(StrictModel):
    """Pause the agents, fly one step of each agent, or end the flights."""

    type: Literal["pause", "step", "end"]


class Fly(StrictModel):
    """Fly one step by hand."""

    type: Literal["fly"]
    direction: Direction
    flight: FlightNumber = 0


class ByHand(StrictModel):
    """Take back the last step flown by hand, or turn on values."""

    type: Literal["undo", "help"]
    flight: FlightNumber = 0


class Subscribe(StrictModel):
    """Choose the topics to receive; replaces the last choice."""

    type: Literal["subscribe"]
    topics: list[Topic] = Field(max_length=3)


Command = Start | Attach | Play | Plain | Fly | ByHand | Subscribe
_COMMAND: TypeAdapter[Command] = TypeAdapter(Annotated[Command, Field(discriminator="type")])


def parse_command(data: bytes | None) -> Command:
    """Parse a command.

    Raises:
        InvalidValueError: if it is not a valid command.
    """
    value: Any = parse_json(data)
    size, kind = len(data or b""), cast(dict[str, Any], value).get("type") if isinstance(value, dict) else None
    if size > SMALL and kind != "start":
        raise InvalidValueError(f"a command other than start may have {SMALL} bytes, got {size}")
    try:
        return _COMMAND.validate_python(value)
    except ValidationError as error:
        # The first part of a name is the type of the command.
        named = {"seed": "the number of the map"}
        raise InvalidValueError(text_of(error, lambda name: named.get(rest := name.partition(".")[2], rest))) from None
