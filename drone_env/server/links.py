"""Addresses of the page: which flight one asks for."""

from collections.abc import Mapping, Sequence
from urllib.parse import urlencode

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from typing_extensions import Self

from drone_env.core.rewards import ORIGINAL_PROFILE, get_reward_profile
from drone_env.core.tasks import MAX_UNITS, get_task
from drone_env.errors import InvalidValueError, UnknownNameError, text_of
from drone_env.server.live.commands import MOST_EPISODES, MapNumber
from drone_env.server.map_choice import DEFAULT_TASK
from drone_env.server.pilots import HUMAN, PILOTS
from drone_env.server.state import LONGEST_ID


class Link(BaseModel):
    """The query of an address. What else stands there is ignored: sites add to links what they like."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    task: str = Field(default=DEFAULT_TASK, max_length=100, description="Id or short name of the task.")
    seed: MapNumber | None = Field(default=None, description="Number of the map.")
    pilot: str = Field(default="", max_length=100, description="Who flies.")
    pilots: str | None = Field(default=None, max_length=400, description="Who race, up to four, separated by commas.")
    profile: str = Field(default=ORIGINAL_PROFILE, max_length=100, description="What the steps pay.")
    step: int | None = Field(default=None, ge=0, le=MAX_UNITS, description="A moment; the end where it is left out.")
    episode: str | None = Field(
        default=None, max_length=LONGEST_ID, description="A stored episode, in place of all else."
    )

    @classmethod
    def of(cls, query: Mapping[str, str]) -> Self:
        """The link with this query.

        Raises:
            InvalidValueError: if a value in it is not allowed.
        """
        try:
            return cls.model_validate(dict(query))
        except ValidationError as error:
            raise InvalidValueError(text_of(error)) from None

    @property
    def names(self) -> list[str]:
        """Ids of the pilots, in order; empty where nobody is named."""
        return [name for name in (self.pilot if self.pilots is None else self.pilots).split(",") if name]

    def check(self) -> None:
        """See whether it names a map, and pilots that there are.

        Raises:
            UnknownNameError: if there is no such task, pilot or reward profile.
            InvalidValueError: if it names no map, or too many pilots.
        """
        get_task(self.task)
        get_reward_profile(self.profile)
        if self.seed is None:
            raise InvalidValueError("the link names no map: it has to have task=hard&seed=7, or episode=ID")
        if len(self.names) > MOST_EPISODES:
            raise InvalidValueError(f"at most {MOST_EPISODES} pilots fly on one map, got {len(self.names)}")
        for name in self.names:
            if name not in PILOTS:
                raise UnknownNameError("pilot", name, PILOTS)

    def query(self) -> str:
        """It as a query again, without what was ignored."""
        return urlencode(self.model_dump(exclude_defaults=True), safe=",")

    def title(self) -> str:
        """What it leads to, in a line, for one that passes `check`."""
        assert self.seed is not None
        if self.names == [HUMAN]:
            return f"Fly it yourself: {title_of(self.task, self.seed)}"
        return title_of(self.task, self.seed, [PILOTS[name].name for name in self.names], self.step)


def title_of(task: str, seed: int, who: Sequence[str] = (), step: int | None = None) -> str:
    """A map, and who flies there, in a line."""
    where = f"{get_task(task).short_name.replace('_', ' ').title()}, map {seed}"
    flown = f"{' against '.join(who)}: {where}" if who else where
    return flown if step is None else f"{flown}, step {step}"
