"""The transcript: every call of a run, one JSON line each, in the file before its answer is used.

Flights, records and figures follow from it, so a killed run resumes from it. A process that dies while it writes
leaves at most a cut last line, and the answer on it was not used.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from drone_env.errors import InvalidValueError
from drone_env.files import append_line, read_lines
from drone_env.llm.answers import Answer, ChatMessage
from drone_env.llm.sender import Part
from drone_env.llm.text_episode import CallKey
from drone_env.models import Count, StrictModel

LONGEST_CALL = 1 << 24
"""Bytes of a line: an answer has at most 4 MiB, and JSON can escape it."""


class Failure(StrictModel):
    """One try without an answer."""

    status: int = Field(ge=0, description="HTTP status, or that of an error in a 200 response; 0 if there was none.")
    reason: str
    waited: float = Field(ge=0, description="Seconds waited before the next try.")


class Call(StrictModel):
    """One call, with all its tries."""

    flight: Count
    turn: int = Field(ge=1)
    attempt: Literal[1, 2]
    messages: list[ChatMessage]
    request_digest: str = Field(description="Digest of the request's body.")
    changes: dict[Part, str | None] = Field(
        default={}, description="Fields that the endpoint rejects: the name that was sent instead; null for none."
    )
    answer: Answer | None = Field(description="Null if no try brought one.")
    outcome: str = Field(description="The kind of the answer, `api_error` or `budget_stop`.")
    failures: list[Failure] = Field(default_factory=list[Failure])
    latency: float = Field(ge=0, description="Duration of the last try in seconds.")
    at: float = Field(description="Time of its end, seconds since 1970.")

    @property
    def key(self) -> CallKey:
        """Its key."""
        return CallKey(self.flight, self.turn, self.attempt)

    def check(self, request: Mapping[str, Any]) -> None:
        """Check that this call sent the request that the run sends now."""
        if (self.messages, self.request_digest) != (request["messages"], digest(request)):
            raise InvalidValueError(f"call {self.key} has another request than this run sends")


def digest(value: object) -> str:
    """SHA-256 of a JSON value, 16 hex digits."""
    text = json.dumps(value, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class Transcript:
    """A transcript to read from and append to, in a locked run folder. Not thread-safe.

    Args:
        path: The file; it is created if it is missing, and a cut last line is removed.

    Attributes:
        calls: The calls that it contained at first.
    """

    def __init__(self, path: Path) -> None:
        self.calls = read_calls(path)
        self._file = path.open("ab", buffering=0)
        self._file.truncate(sum(len(line) for _, line in _whole_lines(path)))

    def append(self, call: Call) -> None:
        """Write a call; it is in the file when this returns."""
        append_line(self._file, call.model_dump_json())

    def close(self) -> None:
        """Sync and close the file."""
        os.fsync(self._file.fileno())
        self._file.close()


def read_calls(path: Path) -> list[Call]:
    """The calls of a transcript, without a cut last line; none if there is no file."""
    return [Call.read(line, f"line {number} of {path} is no call") for number, line in _whole_lines(path)]


def answered_calls(calls: Iterable[Call]) -> dict[int, dict[CallKey, Call]]:
    """The calls with an answer of each flight, in the order of its turns."""
    flights: dict[int, dict[CallKey, Call]] = {}
    for call in sorted((call for call in calls if call.answer is not None), key=lambda call: call.key):
        flights.setdefault(call.flight, {})[call.key] = call
    return flights


def _whole_lines(path: Path) -> list[tuple[int, bytes]]:
    lines = enumerate(list(read_lines(path, LONGEST_CALL)) if path.exists() else [], 1)
    return [(number, line) for number, line in lines if line.endswith(b"\n")]
