"""The rate limiter: as many requests at once and per minute as the endpoint handles, within the budget of the run."""

import asyncio
import time
from collections import deque
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from drone_env.errors import DroneEnvError, EndpointError
from drone_env.llm.options import Options

if TYPE_CHECKING:
    from drone_env.llm.transcript import Call

FIRST = 8
"""The most requests at once before the first answer."""


class LimitReachedError(DroneEnvError):
    """The budget of a run is spent."""


class StoppedError(DroneEnvError):
    """The run is being stopped: this flight is left as it is."""


class Clock:
    """The machine's clock; tests bring another one."""

    def now(self) -> float:
        """Monotonic seconds."""
        return time.monotonic()

    async def sleep(self, seconds: float) -> None:
        """Wait."""
        await asyncio.sleep(seconds)


class Pace:
    """Spaces requests evenly.

    A request counts for the mean number of tokens so far until its answer shows how many it took.

    Args:
        clock: Gives the time, and waits.
        requests: The most per minute; None for no limit.
        tokens: The same.
    """

    def __init__(self, clock: Clock, requests: float | None = None, tokens: float | None = None) -> None:
        self._seconds_per_request = 0.0 if requests is None else 60 / requests
        self._seconds_per_token = 0.0 if tokens is None else 60 / tokens
        self._next_request = self._next_token = self._mean_tokens = 0.0
        self._answers = 0
        self._lock = asyncio.Lock()
        self._clock = clock

    async def turn(self, seconds_left: float) -> float:
        """Wait until a request may go, at most this many seconds; return the number of tokens that it counts for."""
        async with self._lock:
            ends = self._clock.now() + seconds_left
            while (wait := min(max(self._next_request, self._next_token), ends) - self._clock.now()) > 0:
                await self._clock.sleep(wait)
            now, expected = self._clock.now(), self._mean_tokens
            self._next_request = max(self._next_request, now - self._seconds_per_request) + self._seconds_per_request
            self._use(expected)
            return expected

    def used(self, tokens: int | None, expected: float) -> None:
        """Count the tokens of a request for which `expected` ones were reserved; None if it brought no answer."""
        if tokens is not None:
            self._answers += 1
            self._mean_tokens += (tokens - self._mean_tokens) / self._answers
        self._use((tokens or 0) - expected)

    def _use(self, tokens: float) -> None:
        self._next_token = max(self._next_token, self._clock.now()) + tokens * self._seconds_per_token


@dataclass
class Slot:
    """The permission to send one request; the caller notes its result.

    Attributes:
        sent_at: When it was given, by the limiter's clock.
        tokens: How many the answer took; None if none came.
        overloaded: Whether the endpoint could not keep up.
        pause: Seconds during which no request is sent.
    """

    sent_at: float
    tokens: int | None = None
    overloaded: bool = False
    pause: float = 0.0


class RateLimiter:
    """Gives the requests of a run their slots.

    The number of requests at once grows and shrinks as in TCP: a fast start, one more after a round of answers, half as
    many when the endpoint is overloaded.

    Args:
        options: Limits, pace, prices and the most requests at once.
        clock: Gives the time, and waits.

    Attributes:
        requests: Requests sent.
        prompt_tokens, completion_tokens: Paid tokens.
        active: Requests under way.
        limit: The most requests at once, now.
        fatal: Why no further request makes sense; None while they do.
    """

    def __init__(self, options: Options, clock: Clock | None = None) -> None:
        self.options = options
        self.clock = clock or Clock()
        self.requests = self.prompt_tokens = self.completion_tokens = self.active = 0
        self.limit = float(min(FIRST, options.concurrency))
        self.fatal: EndpointError | None = None
        self._started = self.clock.now()
        self._pace = Pace(self.clock, options.requests_per_minute, options.tokens_per_minute)
        self._unmetered = 0
        self._fast = True
        self._closed_until = 0.0
        self._halved_at = -1.0
        self._waiting: deque[asyncio.Future[None]] = deque()

    @property
    def tokens(self) -> int:
        """All paid tokens."""
        return self.prompt_tokens + self.completion_tokens

    @property
    def cost(self) -> float | None:
        """US dollars; None if no price is known."""
        prices = self.options.prices
        return None if prices is None else prices.cost(self.prompt_tokens, self.completion_tokens)

    @property
    def seconds_left(self) -> float:
        """Until the time of the run is over."""
        limit = self.options.max_seconds
        return float("inf") if limit is None else max(0.0, limit - (self.clock.now() - self._started))

    def count(self, call: "Call") -> None:
        """Count the tokens of a call."""
        if call.answer is None or call.cached:
            return
        if call.answer.prompt_tokens is None or call.answer.completion_tokens is None:
            self._unmetered += 1
        self.prompt_tokens += call.answer.prompt_tokens or 0
        self.completion_tokens += call.answer.completion_tokens or 0

    @asynccontextmanager
    async def slot(self) -> AsyncGenerator[Slot, None]:
        """Wait until a request may be sent, count it, and hold its slot until the end of the `with`.

        Raises:
            StoppedError: if the run is being stopped.
            LimitReachedError: if it must not be sent.
        """
        while (pause := self._closed_until - self.clock.now()) > 0 or self.active >= int(self.limit):
            if pause > 0:
                await self.clock.sleep(pause)
                continue
            turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._waiting.append(turn)
            try:
                await turn
            except asyncio.CancelledError:
                self._wake()
                raise
        self.active += 1
        try:
            expected = await self._pace.turn(self.seconds_left)
            self.check_going_on()
            self._check_limits()
            self.requests += 1
            slot = Slot(self.clock.now())
            try:
                yield slot
            finally:
                if slot.overloaded:
                    self._overloaded(slot)
                elif slot.tokens is not None:
                    grown = self.limit + (1 if self._fast else 1 / self.limit)
                    self.limit = min(float(self.options.concurrency), grown)
                self._pace.used(slot.tokens, expected)
        finally:
            self.active -= 1
            self._wake()

    def _overloaded(self, slot: Slot) -> None:
        """Let half as many through; slots from before the last halving do not count."""
        self._fast = False
        pause = min(slot.pause, self.seconds_left)
        self._closed_until = max(self._closed_until, self.clock.now() + pause)
        if slot.sent_at > self._halved_at:
            self.limit = max(1.0, self.limit / 2)
            self._halved_at = self.clock.now()

    def check_going_on(self) -> None:
        """Raise `StoppedError` if no further request makes sense."""
        if self.fatal is not None:
            raise StoppedError("the run is being stopped")

    def _wake(self) -> None:
        free = int(self.limit) - self.active
        while free > 0 and self._waiting:
            turn = self._waiting.popleft()
            if not turn.done():
                turn.set_result(None)
                free -= 1

    def _check_limits(self) -> None:
        limits = self.options
        if limits.max_calls is not None and self.requests >= limits.max_calls:
            raise LimitReachedError(f"all {limits.max_calls} calls have been made")
        if limits.max_seconds is not None and self.seconds_left == 0:
            raise LimitReachedError(f"{limits.max_seconds:g} s have passed")
        if self._unmetered and (limits.max_tokens is not None or limits.max_cost is not None):
            raise LimitReachedError("the endpoint does not say how many tokens it used, so they cannot be limited")
        if limits.max_tokens is not None and self.tokens >= limits.max_tokens:
            raise LimitReachedError(f"{self.tokens} of {limits.max_tokens} tokens have been used")
        if limits.max_cost is not None and (cost := self.cost or 0.0) >= limits.max_cost:
            raise LimitReachedError(f"{cost:.4f} of {limits.max_cost:g} US dollars have been spent")
