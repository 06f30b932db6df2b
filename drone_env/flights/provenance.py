"""The provenance of a flight: who flew it, with what help, and which flight it continues."""

import re
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationError, WithJsonSchema, model_validator
from typing_extensions import Self

from drone_env.errors import InvalidValueError, text_of
from drone_env.models import StrictModel

HUMAN = "human"
"""The pilot of a flight by hand."""
LONGEST_LABEL = 200
PERSON = re.compile(r"[\w-]{1,20}")


def _is_line(text: str) -> str:
    if not (0 < len(text) <= LONGEST_LABEL and text.isprintable()):
        raise ValueError(f"an agent's name is one printable line of 1 to {LONGEST_LABEL} characters, got {text!r}")
    return text


def _is_name(text: str) -> str:
    if not PERSON.fullmatch(text):
        raise ValueError(f"a person's name has 1 to 20 letters, digits, '_' or '-', got {text[:40]!r}")
    return text


def _text(longest: int) -> WithJsonSchema:
    return WithJsonSchema({"type": "string", "minLength": 1, "maxLength": longest})


AgentLabel = Annotated[str, AfterValidator(_is_line), _text(LONGEST_LABEL), Field(description="One printable line.")]
PersonName = Annotated[str, AfterValidator(_is_name), _text(20)]


class Provenance(StrictModel):
    """Who flew a flight, and how. Flights of different provenance are counted separately."""

    pilot: AgentLabel = Field(description="The agent, or `human`: who flew, or who flew on if this is a fork.")
    person: PersonName | None = Field(default=None, description="The name that a person chose.")
    values_used: bool = Field(default=False, description="Whether a person turned on values in flight.")
    undo_used: bool = Field(default=False, description="Whether a person took back steps.")
    parent: "Parent | None" = Field(default=None, description="The flight that this one continues; null if it is none.")

    @model_validator(mode="after")
    def _label_fits(self) -> Self:
        _is_line(self.label)
        return self

    @classmethod
    def of(cls, agent: "str | Provenance") -> "Provenance":
        """Return the provenance of a flight by an agent without help.

        Raises:
            InvalidValueError: if the name is not one printable line of 1 to 200 characters.
        """
        if isinstance(agent, Provenance):
            return agent
        try:
            return Provenance(pilot=agent)
        except ValidationError as error:
            raise InvalidValueError(text_of(error)) from None

    @property
    def label(self) -> str:
        """The provenance in words, as `agent` in documented JSON: `human (Ada) with undo from step 20 of pathqnet`."""
        name = self.pilot if self.person is None else f"{self.pilot} ({self.person})"
        help_used = [words for words, used in (("values", self.values_used), ("undo", self.undo_used)) if used]
        text = f"{name} with {' and '.join(help_used)}" if help_used else name
        return text if self.parent is None else f"{text} from step {self.parent.step} of {self.parent.label}"

    @property
    def is_plain(self) -> bool:
        """Whether the pilot is all that is known."""
        return self.label == self.pilot

    def named(self, person: str | None) -> "Provenance":
        """Return the same flight by a person of this name; None for no name."""
        return self.model_copy(update={"person": person})

    def forked(self, step: int, pilot: str) -> "Provenance":
        """Return the provenance of a fork of this flight.

        A pilot that forks its own flight continues it; for a person this counts as undo. From step 0 a person's own
        flight starts again with its provenance.

        Args:
            step: The number of steps of this flight.
            pilot: The pilot from this step on.

        Raises:
            InvalidValueError: if the label is too long.
        """
        before: Provenance = self
        while before.parent is not None and step <= before.parent.step:
            before = before.parent
        # Not `model_dump`, which would add the step of a `Parent`.
        fields: dict[str, Any] = {name: getattr(before, name) for name in Provenance.model_fields}
        try:
            if before.pilot == pilot:
                helped = before.undo_used or (step > 0 and pilot == HUMAN)
                return Provenance.model_validate({**fields, "undo_used": helped})
            return Provenance(pilot=pilot, parent=Parent(**fields, step=step) if step else None)
        except ValidationError as error:
            raise InvalidValueError(text_of(error)) from None


class Parent(Provenance):
    """The flight that a fork continues."""

    step: int = Field(ge=1, description="The number of its steps that the fork begins with.")


Provenance.model_rebuild()
