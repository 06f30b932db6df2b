"""The budget of a run: its options of speed and cost, what it has used, and when its next request may be sent."""

import asyncio
import math
from collections.abc import AsyncGenerator, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from drone_env.errors import DroneEnvError, InvalidValueError

if TYPE_CHECKING:
    from drone_env.llm.transcript import Call

MAX_CONCURRENCY = 10_000
OPTIONAL = tyro.conf.arg(help_behavior_hint="(optional)")
OptionalNumber = Annotated[float | None, tyro.conf.arg(metavar="X"), OPTIONAL]
Whole = Annotated[int | None, tyro.conf.arg(metavar="N"), OPTIONAL]


@dataclass(frozen=True)
class Options:
    """Speed and budget of a run, which do not change its results. Limits include the earlier parts of a resumed run.

    Tokens and cost are known only after an answer: requests that are open when a limit is reached are still paid.

    Args:
        concurrency: Number of requests at once; an overloaded endpoint gets fewer.
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

    concurrency: int = 8
    timeout: float = 120.0
    tries: int = 6
    backoff: float = 1.0
    requests_per_minute: OptionalNumber = None
    max_calls: Whole = None
    max_tokens: Whole = None
    max_cost: OptionalNumber = None
    price_prompt: OptionalNumber = None
    price_completion: OptionalNumber = None
    server: Annotated[str | None, OPTIONAL] = None

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            may_be_0 = name in ("backoff", "price_prompt", "price_completion")
            if isinstance(value, int | float) and not (0 <= value < math.inf and (value or may_be_0)):
                least = "0 or more" if may_be_0 else "above 0"
                raise InvalidValueError(f"--{name.replace('_', '-')} must be {least}, got {value}")
        if self.concurrency > MAX_CONCURRENCY:
            raise InvalidValueError(f"--concurrency must be at most {MAX_CONCURRENCY}")
        if (self.price_prompt is None) != (self.price_completion is None):
            raise InvalidValueError("give --price-prompt and --price-completion together")
        if self.price_prompt is None and self.max_cost is not None:
            raise InvalidValueError("--max-cost needs --price-prompt and --price-completion")


class LimitReachedError(DroneEnvError):
    """The budget of a run is spent."""


@dataclass
class Budget:
    """Counts the requests and tokens of a run.

    Attributes:
        options: The limits and prices.
        requests: Number of requests sent.
        answers: Number of answers.
        unmetered: Number of answers without a count of their tokens.
        prompt_tokens, completion_tokens: Number of tokens that the answers report; None if none of them does.
    """

    options: Options
    requests: int = 0
    answers: int = 0
    unmetered: int = 0
    prompt_tokens: int | None = None
    completion_tokens: int | None = None

    @property
    def tokens(self) -> int | None:
        """Number of all tokens that the answers report; None if none of them does."""
        return added(self.prompt_tokens, self.completion_tokens)

    @property
    def cost(self) -> float | None:
        """US dollars for these tokens; None if they or their prices are unknown."""
        prompt, completion = self.options.price_prompt, self.options.price_completion
        if prompt is None or completion is None or self.prompt_tokens is None or self.completion_tokens is None:
            return None
        return (self.prompt_tokens * prompt + self.completion_tokens * completion) / 1e6

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
            self.prompt_tokens = added(self.prompt_tokens, answer.prompt_tokens)
            self.completion_tokens = added(self.completion_tokens, answer.completion_tokens)

    def spent(self) -> str | None:
        """Why no further request is within the limits; None if one is."""
        limits = self.options
        if self.unmetered and (limits.max_tokens is not None or limits.max_cost is not None):
            return "the endpoint does not report its tokens, so they cannot be limited"
        for most, used, unit in (
            (limits.max_calls, self.requests, "calls"),
            (limits.max_tokens, self.tokens, "tokens"),
            (limits.max_cost, self.cost, "US dollars"),
        ):
            # Tokens and cost are unknown before the first answer.
            if most is not None and used is not None and used >= most:
                return f"{round(used, 4)} of {most} {unit} have been used"
        return None


def now() -> float:
    """The seconds of the running event loop, which only grow."""
    return asyncio.get_running_loop().time()


class RateLimiter:
    """Decides when a run sends a request; the request that has waited longest is first.

    An overloaded endpoint halves the number of requests at once. It grows by one after as many answers.

    Args:
        budget: The requests and tokens so far, and the options.

    Attributes:
        active: Number of open requests.
        limit: Maximum number of open requests.
    """

    def __init__(self, budget: Budget) -> None:
        self.budget, self.options, self.active = budget, budget.options, 0
        self.limit = budget.options.concurrency
        self._answers = 0
        self._next_request = self._paused_until = 0.0
        self._halved_at = -1.0
        self._first, self._room = asyncio.Lock(), asyncio.Event()

    @asynccontextmanager
    async def slot(self) -> AsyncGenerator[float, None]:
        """Wait until a request may be sent, count it, and hold its slot during the `with`; yields the time.

        Raises:
            LimitReachedError: if the budget is spent.
        """
        async with self._first:
            while self.active >= self.limit:
                self._room.clear()
                await self._room.wait()
            while (wait := max(self._paused_until, self._next_request) - now()) > 0:
                await asyncio.sleep(wait)
            if (spent := self.budget.spent()) is not None:
                raise LimitReachedError(spent)
            # After an idle time, one request may follow without a gap.
            gap = 60 / (self.options.requests_per_minute or math.inf)
            self._next_request = max(self._next_request, now() - gap) + gap
            self.active += 1
            self.budget.requests += 1
        try:
            yield now()
        finally:
            self.active -= 1
            self._room.set()

    def answered(self) -> None:
        """Allow one more request at once after as many answers."""
        self._answers += 1
        if self._answers >= self.limit:
            self._answers, self.limit = 0, min(self.limit + 1, self.options.concurrency)

    def failed(self, sent: float, pause: float, overload: bool) -> None:
        """Send nothing during a pause, and allow half as many requests at once if there were too many.

        Args:
            sent: When the failed request was sent; those from before the last halving do not halve again.
            pause: Seconds.
            overload: Whether it failed because the endpoint has too many.
        """
        self._paused_until = max(self._paused_until, now() + pause)
        if overload and sent > self._halved_at:
            self.limit, self._answers, self._halved_at = max(1, self.limit // 2), 0, now()


def added(*counts: int | None) -> int | None:
    """The sum of the known counts; None if none is known."""
    known = [count for count in counts if count is not None]
    return sum(known) if known else None
