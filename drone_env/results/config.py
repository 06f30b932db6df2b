"""The configuration of an evaluation, as its folder keeps it."""

import re
from typing import Annotated, Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from drone_env.core.seeds import N_SEEDS
from drone_env.errors import shown
from drone_env.models import Message

MOST_PIECES = 1_000_000
Name = Annotated[str, Field(max_length=1000)]


class EvaluationConfig(Message):
    """What decides the results of an evaluation. A network's file is named by its digest, not by its path."""

    format: Literal["drone_env/evaluation"] = "drone_env/evaluation"
    format_version: Literal[1] = 1
    package: Name
    piece: int = Field(ge=1, le=MOST_PIECES)
    split: Name
    seeds: list[Annotated[int, Field(ge=0, le=N_SEEDS)]] = Field(min_length=2, max_length=2)
    repeats: dict[Name, Annotated[int, Field(ge=2, le=MOST_PIECES)]] = Field(default_factory=dict)
    tasks: list[Name]
    agents: dict[Name, Annotated[str, Field(pattern="^[0-9a-f]{16}$")]]

    @model_validator(mode="after")
    def _flyable(self) -> Self:
        start, stop = self.seeds
        if not 0 < stop - start <= MOST_PIECES * self.piece:
            raise ValueError(f"seeds {start}:{stop} are not 1 to {MOST_PIECES:,} pieces of {self.piece} maps")
        versions = self.versions()
        for label in self.agents:
            if label.rpartition(" on ")[2] not in versions:
                raise ValueError(f"agents: {shown(label)} does not end in ' on TASK', with a task of `tasks`")
        return self

    def versions(self) -> dict[str, int]:
        """The version of each task by its id.

        Raises:
            ValueError: if a task does not name its version.
        """
        named = [(task, re.fullmatch("(.+) v([0-9]{1,9})", task)) for task in self.tasks]
        wrong = [task for task, parts in named if parts is None]
        if wrong:
            raise ValueError(f"tasks: {shown(wrong[0])} is not 'TASK vVERSION'")
        return {parts[1]: int(parts[2]) for _, parts in named if parts}
