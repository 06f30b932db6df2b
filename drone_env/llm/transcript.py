"""The transcript: every call of a run, one JSON line each, in the file before its answer is used.

Flights, records and figures follow from it, so a killed run resumes from it. A process that dies while it writes
leaves at most a cut last line, and the answer on it was not used. The key of each request is in a second file before
the request is sent, so that those under way when a process dies are counted.
"""

import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import Field

from drone_env.errors import InvalidValueError
from drone_env.files import append_line, read_lines
from drone_env.llm.answers import Answer, ChatMessage
from drone_env.llm.rejections import Part
from drone_env.models import Count, StrictModel

SENT = "sent.txt"
LONGEST_CALL = 1 << 24
"""Bytes of a line: an answer has at most 4 MiB, and JSON can escape it."""


class CallKey(NamedTuple):
    """Identifies a call of a run: flight from 0, turn from 1, attempt 1, or 2 after an unusable answer."""

    flight: int
    turn: int
    attempt: int

    def __str__(self) -> str:
        return f"{self.flight}-{self.turn}-{self.attempt}"


class Failure(StrictModel):
    """One try without an answer."""

    status: int = Field(ge=0, description="HTTP status, or that of an error in a 200 response; 0 if there was none.")
    reason: str
    waited: float = Field(ge=0, description="Seconds waited before the next try.")


class Call(StrictModel):
    """One call, with all its tries."""

    flight: Count
    seed: Count
    repeat: Count
    turn: int = Field(ge=1)
    attempt: Literal[1, 2]
    messages: list[ChatMessage]
    request_digest: str = Field(description="Digest of the request's body.")
    sampling_seed: int | None = Field(default=None, description="The seed in the request: the run's plus `repeat`.")
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

    def answer_to(self, request: Mapping[str, Any]) -> Answer:
        """The answer, if this call sent the same request as the run sends now."""
        sent = (self.messages, self.request_digest, self.sampling_seed)
        if self.answer is None or sent != (request["messages"], digest(request), request.get("seed")):
            raise InvalidValueError(f"call {self.key} has another request than this run sends")
        return self.answer


def digest(value: object) -> str:
    """SHA-256 of a JSON value, 16 hex digits."""
    text = json.dumps(value, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class Transcript:
    """A transcript to read from and append to, in a locked run folder. Not thread-safe.

    Args:
        path: The file; it and `sent.txt` beside it are created if they are missing, and a cut last line is removed.

    Attributes:
        calls: All calls.
        sent: The call of each request sent before.
        answered: The calls with an answer.
    """

    def __init__(self, path: Path) -> None:
        sent = path.with_name(SENT)
        path.touch()
        sent.touch()
        self.calls, self.sent = list(read_calls(path)), list(read_sent(sent))
        self._file, self._sent = path.open("ab", buffering=0), sent.open("ab", buffering=0)
        for file, lines in ((self._file, _whole_lines(path)), (self._sent, _whole_lines(sent))):
            file.truncate(sum(len(line) for _, line in lines))
        self.answered = {call.key: call for call in self.calls if call.answer is not None}

    def sending(self, key: CallKey) -> str:
        """Write that a request is about to be sent; returns the key as text."""
        call_id = str(key)
        append_line(self._sent, call_id)
        return call_id

    def append(self, call: Call) -> None:
        """Write a call; it is in the file when this returns."""
        key = call.key
        append_line(self._file, call.model_dump_json())
        self.calls.append(call)
        if call.answer is not None:
            self.answered[key] = call

    def close(self) -> None:
        """Sync and close the file."""
        for file in (self._file, self._sent):
            os.fsync(file.fileno())
            file.close()


def requests_of(calls: Iterable[Call]) -> Counter[CallKey]:
    """The number of requests of each call."""
    requests: Counter[CallKey] = Counter()
    for call in calls:
        requests[call.key] += len(call.failures) + (call.answer is not None)
    return requests


def read_sent(path: Path) -> Iterator[CallKey]:
    """The call of each request that was sent, in order, without a cut last line."""
    for number, line in _whole_lines(path):
        if not re.fullmatch(rb"(0|[1-9]\d*)-[1-9]\d*-[12]\n", line):
            raise InvalidValueError(f"line {number} of {path} is not FLIGHT-TURN-ATTEMPT")
        yield CallKey(*map(int, line.split(b"-")))


def read_calls(path: Path) -> Iterator[Call]:
    """The calls of a transcript, without a cut last line."""
    seen: set[CallKey] = set()
    for number, line in _whole_lines(path):
        call = Call.read(line, f"line {number} of {path} is no call")
        if call.answer is not None:
            if call.key in seen:
                raise InvalidValueError(f"line {number} of {path}: call {call.key} has an answer already")
            seen.add(call.key)
        yield call


def _whole_lines(path: Path) -> list[tuple[int, bytes]]:
    lines = enumerate(list(read_lines(path, LONGEST_CALL)), 1)
    return [(number, line) for number, line in lines if line.endswith(b"\n")]
