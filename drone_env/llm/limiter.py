"""The rate limiter: requests at once and per minute, within the budget of a run."""

import asyncio
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from drone_env.errors import InvalidValueError
from drone_env.llm.text_episode import LimitReachedError

if TYPE_CHECKING:
    from drone_env.llm.transcript import Call

MAX_CONCURRENCY = 10_000
FIRST_CONCURRENCY = 8
"""Maximum number of requests at once before the first answer."""
OPTIONAL = tyro.conf.arg(help_behavior_hint="(optional)")
Number = Annotated[float | None, tyro.conf.arg(metavar="X"), OPTIONAL]
Whole = Annotated[int | None, tyro.conf.arg(metavar="N"), OPTIONAL]


@dataclass(frozen=True)
class Options:
    """Speed and budget of a run, which do not change its results. Limits include the earlier parts of a resumed run.

    Tokens and cost are known only after an answer: requests that are open when a limit is reached are still paid.

    Args:
        concurrency: Maximum number of requests at once; fewer while the endpoint is overloaded.
        timeout: Maximum duration of a request in seconds.
        tries: Maximum number of tries of a call that fails with 408, 409, 429, 5xx or a network error.
        backoff: Upper bound of the first random wait in seconds; it doubles with each try, up to 30 s.
        requests_per_minute: Maximum number of requests per minute, including retries, evenly spaced.
        max_calls: Stop after this many requests, including retries.
        max_tokens: Stop after this many tokens.
        max_cost: Stop after this many US dollars.
        price_prompt: US dollars per million prompt tokens.
        price_completion: US dollars per million completion tokens.
        server: Also fly every step on the server at this address.
    """

    concurrency: int = 64
    timeout: float = 120.0
    tries: int = 6
    backoff: float = 1.0
    requests_per_minute: Number = None
    max_calls: Whole = None
    max_tokens: Whole = None
    max_cost: Number = None
    price_prompt: Number = None
    price_completion: Number = None
    server: Annotated[str | None, OPTIONAL] = None

    def __post_init__(self) -> None:
        for name in ("concurrency", "timeout", "tries", "requests_per_minute", "max_calls", "max_tokens", "max_cost"):
            value = getattr(self, name)
            if value is not None and not 0 < value < float("inf"):
                raise InvalidValueError(f"--{name.replace('_', '-')} must be above 0, got {value}")
        if self.concurrency > MAX_CONCURRENCY or not self.backoff >= 0:
            raise InvalidValueError(f"--concurrency must be at most {MAX_CONCURRENCY}, --backoff 0 or more")
        if (self.price_prompt is None) != (self.price_completion is None):
            raise InvalidValueError("give --price-prompt and --price-completion together")
        if self.price_prompt is None and self.max_cost is not None:
            raise InvalidValueError("--max-cost needs --price-prompt and --price-completion")
        if not all(
            0 <= price < float("inf") for price in (self.price_prompt, self.price_completion) if price is not None
        ):
            raise InvalidValueError("prices must be 0 or more US dollars per million tokens")


class Budget:
    """Counts the requests and tokens of a run.

    Args:
        options: The limits and prices.

    Attributes:
        requests: Number of requests sent.
        prompt_tokens, completion_tokens: Number of tokens that the answers report; None if none of them does.
        unmetered: Number of answers without a count of their tokens.
    """

    def __init__(self, options: Options) -> None:
        self.requests = self.unmetered = 0
        self.prompt_tokens: int | None = None
        self.completion_tokens: int | None = None
        self._options = options

    @property
    def tokens(self) -> int | None:
        """Number of all tokens that the answers report; None if none of them does."""
        return added(self.prompt_tokens, self.completion_tokens)

    @property
    def cost(self) -> float | None:
        """US dollars for these tokens; None if they or their prices are unknown."""
        prompt, completion = self._options.price_prompt, self._options.price_completion
        if prompt is None or completion is None or self.prompt_tokens is None or self.completion_tokens is None:
            return None
        return (self.prompt_tokens * prompt + self.completion_tokens * completion) / 1e6

    def resume(self, calls: Iterable["Call"]) -> None:
        """Count the requests and tokens of earlier calls."""
        for call in calls:
            self.requests += call.requests
            self.count(call)

    def count(self, call: "Call") -> None:
        """Count the tokens of a call."""
        if (answer := call.answer) is not None:
            self.unmetered += answer.prompt_tokens is None or answer.completion_tokens is None
            self.prompt_tokens = added(self.prompt_tokens, answer.prompt_tokens)
            self.completion_tokens = added(self.completion_tokens, answer.completion_tokens)

    def check(self) -> None:
        """Check that one more request is within the limits.

        Raises:
            LimitReachedError: if it is not.
        """
        limits = self._options
        if limits.max_calls is not None and self.requests >= limits.max_calls:
            raise LimitReachedError(f"all {limits.max_calls} calls have been made")
        if self.unmetered and (limits.max_tokens is not None or limits.max_cost is not None):
            raise LimitReachedError("the endpoint does not report its tokens, so they cannot be limited")
        # Neither is known before the first answer.
        if limits.max_tokens is not None and (tokens := self.tokens) is not None and tokens >= limits.max_tokens:
            raise LimitReachedError(f"{tokens} of {limits.max_tokens} tokens have been used")
        if limits.max_cost is not None and (cost := self.cost) is not None and cost >= limits.max_cost:
            raise LimitReachedError(f"{cost:.4f} of {limits.max_cost:g} US dollars have been spent")


def added(*counts: int | None) -> int | None:
    """The sum of the known counts; None if none is known."""
    known = [count for count in counts if count is not None]
    return sum(known) if known else None


class RateLimiter:
    """Decides when a request of a run is sent.

    Concurrency control is that of TCP: slow start, then one more slot per round of answers, and half as many slots when
    the endpoint is overloaded.

    Args:
        options: Limits, rate, prices and maximum concurrency.
        now: Returns monotonic seconds.
        sleep: Waits for seconds.

    Attributes:
        budget: The requests and tokens so far.
        active: Number of open requests.
        limit: Current maximum number of open requests.
    """

    def __init__(
        self,
        options: Options,
        now: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        self.options = options
        self.now, self.sleep = now, sleep
        self.budget = Budget(options)
        self.active = 0
        self.limit = float(min(FIRST_CONCURRENCY, options.concurrency))
        self._slow_start = True
        self._next_request = self._paused_until = 0.0
        self._halved_at = -1.0
        self._changed = asyncio.Condition()

    @asynccontextmanager
    async def slot(self) -> AsyncGenerator[float, None]:
        """Wait until a request may be sent, count it, and hold its slot until the end of the `with`.

        Yields the time at which the request is sent.

        Raises:
            LimitReachedError: if the budget is spent.
        """
        async with self._changed:
            await self._changed.wait_for(lambda: self.active < int(self.limit))
            self.active += 1
        try:
            await self._pace()
            self.budget.check()
            self.budget.requests += 1
            yield self.now()
        finally:
            async with self._changed:
                self.active -= 1
                self._changed.notify_all()

    async def _pace(self) -> None:
        """Wait until the end of a pause, and space requests evenly."""
        per_minute = self.options.requests_per_minute
        if per_minute is not None:
            gap, now = 60 / per_minute, self.now()
            # After an idle time, one request may follow without a gap.
            sent_at = max(self._next_request, now)
            self._next_request = max(self._next_request, now - gap) + gap
            await self._sleep_until(sent_at)
        while self._paused_until > self.now():
            await self._sleep_until(self._paused_until)

    async def _sleep_until(self, when: float) -> None:
        if (seconds := when - self.now()) > 0:
            await self.sleep(seconds)

    def answered(self) -> None:
        """Allow more requests at once after an answer."""
        grown = self.limit + (1 if self._slow_start else 1 / self.limit)
        self.limit = min(float(self.options.concurrency), grown)

    def overloaded(self, sent_at: float, pause: float) -> None:
        """Allow half as many requests at once, and none during a pause.

        Args:
            sent_at: When the failed request was sent; requests from before the last halving do not halve again.
            pause: Seconds.
        """
        self._slow_start = False
        self._paused_until = max(self._paused_until, self.now() + pause)
        if sent_at > self._halved_at:
            self.limit = max(1.0, self.limit / 2)
            self._halved_at = self.now()
