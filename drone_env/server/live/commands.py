"""What the page may send: one JSON object with a `type`."""

from typing import Annotated, Any, Literal

from pydantic import Field, TypeAdapter, ValidationError, ValidatorFunctionWrapHandler, WrapValidator
from pydantic_core import PydanticCustomError

from drone_env.errors import InvalidValueError, text_of
from drone_env.models import MAX_SEED, Direction, Message, Seed
from drone_env.server.incoming import parse_json
from drone_env.server.state import LONGEST_ID

MOST_EPISODES = 4


def _say_the_range(value: Any, check: ValidatorFunctionWrapHandler) -> int:
    try:
        return check(value)
    except ValidationError:
        # People come here by links that they have written themselves.
        message = "the number of a map is a whole number from 0 to {most}"
        raise PydanticCustomError("seed", message, {"most": MAX_SEED}) from None


MapNumber = Annotated[Seed, WrapValidator(_say_the_range)]
Number = Annotated[
    int | None,
    Field(ge=0, le=MAX_SEED, description="The answer repeats it."),
]
Topic = Literal["requests", "training", "episodes"]


class Start(Message):
    """Fly one map with one to four pilots; the flights before are given up."""

    type: Literal["start"]
    task: str = Field(max_length=100)
    pilots: list[str] = Field(min_length=1, max_length=MOST_EPISODES)
    seed: MapNumber | None = None
    reward_profile: str | None = Field(default=None, max_length=100)
    number: Number = None


class Attach(Message):
    """Go on with flights after the connection was lost."""

    type: Literal["attach"]
    sessions: list[Annotated[str, Field(max_length=LONGEST_ID)]] = Field(min_length=1, max_length=MOST_EPISODES)
    number: Number = None


class Play(Message):
    """Let the pilots fly by themselves."""

    type: Literal["play"]
    speed: float | None = Field(default=None, ge=0.5, le=60, description="Steps per second.")


class Plain(Message):
    """Stop them; have each that flies by itself fly one step; give the flights up."""

    type: Literal["pause", "step", "end"]


class Fly(Message):
    """One step of a flight that a person flies."""

    type: Literal["fly"]
    direction: Direction
    flight: int = Field(default=0, ge=0, lt=MOST_EPISODES)


class Subscribe(Message):
    """Which news to send beside the flights; replaces the choice before."""

    type: Literal["subscribe"]
    topics: list[Topic] = Field(max_length=3)


Command = Start | Attach | Play | Plain | Fly | Subscribe
_COMMAND: TypeAdapter[Command] = TypeAdapter(Annotated[Command, Field(discriminator="type")])


def parse_command(text: str) -> Command:
    """The command in a frame.

    Raises:
        InvalidValueError: if it is none; the message says what is allowed.
    """
    value: Any = parse_json(text)
    try:
        return _COMMAND.validate_python(value)
    except ValidationError as error:
        raise InvalidValueError(text_of(error)) from None
