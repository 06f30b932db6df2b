"""Reward profiles from TOML files.

    id = "mine"
    summary = "rewards deliveries, punishes time"
    shaping = 0.05                # per cell closer to the target
    clamp = [-1.0, 1.0]           # bounds of the sum of event reward and shaping
    shaping_gamma = 0.99          # potential-based shaping on top
    pays_score = false            # whether the end adds the graded score
    task_events = false           # whether other events than those below give the task's rewards, instead of 0

    [events]
    delivery = 1.0
    step = -0.01

All keys but `id` are optional.
"""

from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from drone_env.core.actions import Event
from drone_env.core.rewards import PACKAGE_PROFILES, RewardProfile, get_reward_profile
from drone_env.errors import InvalidTaskError, InvalidValueError, abbreviate
from drone_env.files import read_file
from drone_env.models import EventName
from drone_env.toml_text import read_toml

MAX_FILE = 1 << 16


def _free(name: str) -> str:
    if name in PACKAGE_PROFILES:
        raise ValueError(f"{abbreviate(name)} is taken by a profile of the package")
    return name


RewardNumber = Annotated[Decimal, Field(strict=False)]
"""TOML's decimals are parsed as `Decimal`, so that 0.1 is exact."""


class RewardFile(BaseModel):
    """The keys and types of the file of a reward profile."""

    model_config = ConfigDict(strict=True, extra="forbid")

    id: Annotated[str, Field(min_length=1), AfterValidator(_free)]
    summary: str = ""
    shaping: RewardNumber = Decimal(0)
    clamp: Annotated[tuple[RewardNumber, RewardNumber] | None, Field(strict=False)] = None
    shaping_gamma: RewardNumber | None = None
    pays_score: bool = False
    task_events: bool = False
    events: dict[EventName, RewardNumber] = {}


def chosen_profile(name: str | RewardProfile) -> RewardProfile:
    """Return the reward profile of a name or a TOML file; a `RewardProfile` is returned unchanged.

    Raises:
        UnknownNameError: if the name does not end in `.toml` and there is no such profile.
        OSError: if the file cannot be read.
        InvalidTaskError: if the file is not a reward profile.
    """
    if isinstance(name, str) and name.endswith(".toml"):
        return load_reward_profile(name)
    return get_reward_profile(name)


def load_reward_profile(path: str | Path) -> RewardProfile:
    """Read a reward profile from a TOML file. Its numbers stay exact decimals.

    Raises:
        OSError: if the file cannot be read.
        InvalidTaskError: if it is not a reward profile.
    """
    try:
        file = read_toml(read_file(path, MAX_FILE), RewardFile, parse_float=Decimal)
    except InvalidValueError as error:
        message = str(error).removeprefix(f"{path} ")  # of `read_file`
        raise InvalidTaskError(f"reward profile {path}: {message}") from None
    events: Any = tuple((Event[name.upper()], pay) for name, pay in file.events.items())
    return RewardProfile(**{**dict(file), "events": events})
