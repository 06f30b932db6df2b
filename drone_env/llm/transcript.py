"""The transcript: every call of a run, one JSON line each, in the file before anything is done with the answer.

It is the one source of a run: flights, records and figures all follow from it, so a run that was killed goes on from
it. A process that dies while it writes leaves at most a cut last line, whose call was not acknowledged.
"""

import os
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Literal, NamedTuple

from pydantic import Field

from drone_env.errors import InvalidValueError
from drone_env.files import locked, read_lines
from drone_env.llm.answers import Answer
from drone_env.llm.messages import ChatMessage
from drone_env.models import Count, Message

LONGEST_CALL = 1 << 24
"""Bytes of a line: an answer has at most 4 MiB, and JSON may escape it."""


class CallKey(NamedTuple):
    """Which call of a run: flight from 0, turn from 1, attempt 1 or, after a bad answer, 2."""

    flight: int
    turn: int
    attempt: int

    def __str__(self) -> str:
        return f"{self.flight}-{self.turn}-{self.attempt}"


class Failure(Message):
    """One try that brought no answer."""

    status: int = Field(ge=0, description="HTTP status, or that of an error in a 200 response; 0 if there was none.")
    reason: str
    waited: float = Field(ge=0, description="Seconds waited before the next try.")


class Call(Message):
    """One call, with all its tries."""

    flight: Count
    seed: Count
    repeat: Count
    turn: int = Field(ge=1)
    attempt: Literal[1, 2]
    messages: list[ChatMessage] = Field(description="Of a picture, what it shows.")
    picture: str | None = Field(default=None, description="SHA-256 of the PNG that was sent: how it looked.")
    request_digest: str = Field(description="Of the messages and all that is sent with them.")
    sampling_seed: int | None = Field(default=None, description="The seed that was sent: the run's plus `repeat`.")
    answer: Answer | None = Field(description="Null where no try brought one.")
    outcome: str = Field(description="How the answer was understood, or `api_error`.")
    failures: list[Failure] = Field(default_factory=list[Failure])
    latency: float = Field(ge=0, description="Seconds that the last try took.")
    at: float = Field(description="When it was done, seconds since 1970.")
    cached: bool = Field(default=False, description="Whether the answer is from the cache and was not paid.")

    @property
    def key(self) -> CallKey:
        """Which call it is."""
        return CallKey(self.flight, self.turn, self.attempt)

    @property
    def requests(self) -> int:
        """How many requests were sent for it."""
        return len(self.failures) + (self.answer is not None and not self.cached)


class Transcript:
    """A transcript to read from and append to. Not for several threads.

    Args:
        path: The file; it is made where it is missing, and a cut last line is removed.

    Raises:
        OSError: if it cannot be opened.
        InvalidValueError: if a line is no call; the message says which. Or if another process writes to it, such as
            one on a cluster whose driver has just died.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.calls: list[Call] = []
        with ExitStack() as opened:
            opened.enter_context(locked(path.with_suffix(".lock"), f"another process writes to {path}"))
            self._file = opened.enter_context(path.open("ab+", buffering=0))
            self._read()
            self._opened = opened.pop_all()
        self.answered = {call.key: call for call in self.calls if call.answer is not None}

    def append(self, call: Call) -> None:
        """Write a call; it is in the file when this returns.

        Raises:
            OSError: if it cannot be written.
        """
        data = f"{call.model_dump_json()}\n".encode()
        written = self._file.write(data)
        if written != len(data):
            # The next call would stand on the same line.
            self._file.truncate(self._file.tell() - (written or 0))
            raise OSError(f"a call could not be written whole to {self.path}")
        self.calls.append(call)
        if call.answer is not None:
            self.answered[call.key] = call

    def close(self) -> None:
        """Put all on the disk and close the file."""
        if not self._file.closed:
            os.fsync(self._file.fileno())
            self._opened.close()

    def _read(self) -> None:
        end = 0
        for size, call in read_calls(self.path):
            end += size
            self.calls.append(call)
        self._file.truncate(end)


def read_calls(path: Path) -> Iterator[tuple[int, Call]]:
    """The calls of a transcript, each with the bytes of its line; a cut last line is left out.

    Raises:
        OSError: if it cannot be read.
        InvalidValueError: at a line that is no call, or the second answer of one.
    """
    seen: set[CallKey] = set()
    for number, line in enumerate(read_lines(path, LONGEST_CALL), 1):
        if not line.endswith(b"\n"):
            return
        call = Call.read(line, f"line {number} of {path} is no call")
        if call.answer is not None:
            if call.key in seen:
                raise InvalidValueError(f"line {number} of {path}: call {call.key} has an answer already")
            seen.add(call.key)
        yield len(line), call
