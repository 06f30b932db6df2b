"""The rate limiter: as many requests at once and per minute as the endpoint handles, within the budget of the run."""

import asyncio
import time
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
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
        self._unmetered = 0
        self._fast = True
        self._next_request = self._closed_until = 0.0
        self._halved_at = -1.0
        self._changed = asyncio.Condition()

    @property
    def tokens(self) -> int:
        """All paid tokens."""
        return self.prompt_tokens + self.completion_tokens

    @property
    def cost(self) -> float | None:
        """US dollars; None if no price is known."""
        prices = self.options.prices
        return None if prices is None else prices.cost(self.prompt_tokens, self.completion_tokens)

    def count(self, call: "Call") -> None:
        """Count the tokens of a call."""
        if call.answer is None or call.cached:
            return
        if call.answer.prompt_tokens is None or call.answer.completion_tokens is None:
            self._unmetered += 1
        self.prompt_tokens += call.answer.prompt_tokens or 0
        self.completion_tokens += call.answer.completion_tokens or 0

    @asynccontextmanager
    async def slot(self) -> AsyncGenerator[float, None]:
        """Wait until a request may be sent, count it, and hold its slot until the end of the `with`.

        Gives the time at which the request is sent.

        Raises:
            StoppedError: if the run is being stopped.
            LimitReachedError: if it must not be sent.
        """
        async with self._changed:
            await self._changed.wait_for(lambda: self.active < int(self.limit))
            self.active += 1
        try:
            await self._turn()
            self.check_going_on()
            self._check_limits()
            self.requests += 1
            yield self.clock.now()
        finally:
            async with self._changed:
                self.active -= 1
                self._changed.notify_all()

    async def _turn(self) -> None:
        """Wait out pauses, and the even spacing of requests per minute."""
        per_minute = self.options.requests_per_minute
        if per_minute is not None:
            gap, now = 60 / per_minute, self.clock.now()
            # One gap may be made up for, however long nothing was sent.
            sent_at = max(self._next_request, now)
            self._next_request = max(self._next_request, now - gap) + gap
            await self._sleep_until(sent_at)
        while self._closed_until > self.clock.now():
            await self._sleep_until(self._closed_until)

    async def _sleep_until(self, when: float) -> None:
        if (seconds := when - self.clock.now()) > 0:
            await self.clock.sleep(seconds)

    def answered(self) -> None:
        """Allow more requests at once: the endpoint keeps up."""
        grown = self.limit + (1 if self._fast else 1 / self.limit)
        self.limit = min(float(self.options.concurrency), grown)

    def overloaded(self, sent_at: float, pause: float) -> None:
        """Allow half as many requests at once, and none during a pause.

        Args:
            sent_at: When the request was sent that failed; only the first one after a halving halves again.
            pause: Seconds.
        """
        self._fast = False
        self._closed_until = max(self._closed_until, self.clock.now() + pause)
        if sent_at > self._halved_at:
            self.limit = max(1.0, self.limit / 2)
            self._halved_at = self.clock.now()

    def check_going_on(self) -> None:
        """Raise `StoppedError` if no further request makes sense."""
        if self.fatal is not None:
            raise StoppedError("the run is being stopped")

    def _check_limits(self) -> None:
        limits = self.options
        if limits.max_calls is not None and self.requests >= limits.max_calls:
            raise LimitReachedError(f"all {limits.max_calls} calls have been made")
        if self._unmetered and (limits.max_tokens is not None or limits.max_cost is not None):
            raise LimitReachedError("the endpoint does not say how many tokens it used, so they cannot be limited")
        if limits.max_tokens is not None and self.tokens >= limits.max_tokens:
            raise LimitReachedError(f"{self.tokens} of {limits.max_tokens} tokens have been used")
        if limits.max_cost is not None and (cost := self.cost or 0.0) >= limits.max_cost:
            raise LimitReachedError(f"{cost:.4f} of {limits.max_cost:g} US dollars have been spent")
