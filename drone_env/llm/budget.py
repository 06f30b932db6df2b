"""The budget of a run: its options of speed and cost, what it has used, and when its next request may be sent."""

import asyncio
import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from drone_env.errors import DroneEnvError, InvalidValueError

if TYPE_CHECKING:
    from drone_env.llm.transcript import Call

OPTIONAL = tyro.conf.arg(help_behavior_hint="(optional)")
Whole = Annotated[int | None, tyro.conf.arg(metavar="N"), OPTIONAL]


@dataclass(frozen=True)
class Options:
    """Speed and budget of a run, which do not change its results. Limits include the earlier parts of a resumed run.

    Tokens are known only after an answer: requests that are open when a limit is reached are still paid.

    Args:
        concurrency: Number of requests at once.
        timeout: Maximum duration of a request in seconds.
        tries: Maximum number of tries of a call that fails with 408, 409, 429, 5xx or a network error.
        backoff: Upper bound of the first random wait in seconds; it doubles with each try, up to 30 s.
        requests_per_minute: Maximum number of requests per minute, including retries, evenly spaced.
        max_calls: Stop after this many requests, including retries.
        max_tokens: Stop after this many tokens.
        server: Also fly every flight on the server at this address, whose observations must equal those here.
    """

    concurrency: int = 8
    timeout: float = 120.0
    tries: int = 8
    backoff: float = 1.0
    requests_per_minute: Annotated[float | None, tyro.conf.arg(metavar="X"), OPTIONAL] = None
    max_calls: Whole = None
    max_tokens: Whole = None
    server: Annotated[str | None, OPTIONAL] = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, int | float) and not (0 < value < math.inf or (name == "backoff" and value == 0)):
                raise InvalidValueError(f"--{name.replace('_', '-')} must be above 0, got {value}")


class LimitReachedError(DroneEnvError):
    """The budget of a run is spent."""


def now() -> float:
    """The seconds of the running event loop, which only grow."""
    return asyncio.get_running_loop().time()


class Budget:
    """Counts the requests and tokens of a run, and decides when it sends a request: the longest waiting one is first.

    Args:
        options: The limits.

    Attributes:
        requests: Number of requests sent.
        answers: Number of answers.
        unmetered: Number of answers without a count of their tokens.
        prompt_tokens, completion_tokens: Number of tokens that the answers report; None if none of them does.
        models: Number of answers by the model that the endpoint names; "" if it names none.
    """

    def __init__(self, options: Options) -> None:
        self.options = options
        self.requests = self.answers = self.unmetered = 0
        self.prompt_tokens: int | None = None
        self.completion_tokens: int | None = None
        self.models: Counter[str] = Counter()
        self._next_request = self._paused_until = 0.0
        self._first = asyncio.Lock()

    @property
    def tokens(self) -> int | None:
        """Number of all tokens that the answers report; None if none of them does."""
        return _added(self.prompt_tokens, self.completion_tokens)

    def resume(self, calls: Iterable["Call"]) -> None:
        """Count the requests and the tokens of earlier calls."""
        for call in calls:
            self.requests += len(call.failures) + (call.answer is not None)
            self.count(call)

    def count(self, call: "Call") -> None:
        """Count the tokens of a call."""
        if (answer := call.answer) is not None:
            self.answers += 1
            self.unmetered += answer.prompt_tokens is None or answer.completion_tokens is None
            self.prompt_tokens = _added(self.prompt_tokens, answer.prompt_tokens)
            self.completion_tokens = _added(self.completion_tokens, answer.completion_tokens)
            self.models[answer.model or ""] += 1

    async def turn(self) -> None:
        """Wait until a request may be sent, and count it.

        Raises:
            LimitReachedError: if no further request is within the limits.
        """
        async with self._first:
            while (wait := max(self._paused_until, self._next_request) - now()) > 0:
                await asyncio.sleep(wait)
            self._check()
            # After an idle time, one request may follow without a gap.
            gap = 60 / (self.options.requests_per_minute or math.inf)
            self._next_request = max(self._next_request, now() - gap) + gap
            self.requests += 1

    def _check(self) -> None:
        most_calls, most_tokens = self.options.max_calls, self.options.max_tokens
        if most_calls is not None and self.requests >= most_calls:
            raise LimitReachedError(f"{self.requests} of {most_calls} calls have been used")
        if most_tokens is not None and self.unmetered:
            raise LimitReachedError("the endpoint does not report its tokens, so they cannot be limited")
        if most_tokens is not None and (self.tokens or 0) >= most_tokens:
            raise LimitReachedError(f"{self.tokens} of {most_tokens} tokens have been used")

    def pause(self, seconds: float) -> None:
        """Send nothing for these seconds."""
        self._paused_until = max(self._paused_until, now() + seconds)


def _added(*counts: int | None) -> int | None:
    """The sum of the known counts; None if none is known."""
    known = [count for count in counts if count is not None]
    return sum(known) if known else None
