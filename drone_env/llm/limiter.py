"""The rate limiter: requests at once and per minute, within the budget of a run, the first flights first."""

import asyncio
import heapq
import itertools
import math
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from drone_env.errors import InvalidValueError
from drone_env.llm.concurrency import PROMPT_TOKENS, ConcurrencySearch, Round
from drone_env.llm.text_episode import LimitReachedError

if TYPE_CHECKING:
    from drone_env.llm.answers import Answer
    from drone_env.llm.transcript import Call

MAX_CONCURRENCY = 10_000
FIRST_CONCURRENCY = 8
"""Number of requests at once before the first answer; 1 on this machine, where many servers answer one at a time."""
OPTIONAL = tyro.conf.arg(help_behavior_hint="(optional)")
Number = Annotated[float | None, tyro.conf.arg(metavar="X"), OPTIONAL]
Whole = Annotated[int | None, tyro.conf.arg(metavar="N"), OPTIONAL]


@dataclass(frozen=True)
class Options:
    """Speed and budget of a run, which do not change its results. Limits include the earlier parts of a resumed run.

    Tokens and cost are known only after an answer: requests that are open when a limit is reached are still paid.

    Args:
        concurrency: Maximum number of requests at once; fewer if more bring no more answers.
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


class Budget:
    """Counts the requests and tokens of a run.

    Args:
        options: The limits and prices.

    Attributes:
        requests: Number of requests sent.
        answers: Number of answers.
        prompt_tokens, completion_tokens: Number of tokens that the answers report; None if none of them does.
        unmetered: Number of answers without a count of their tokens.
    """

    def __init__(self, options: Options) -> None:
        self.requests = self.answers = self.unmetered = 0
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

    def resume(self, calls: Iterable["Call"], requests: int) -> None:
        """Count the requests and the tokens of earlier calls."""
        self.requests += requests
        for call in calls:
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
        limits = self._options
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

    def calls_left(self, active: int) -> float:
        """The number of requests that the limits still allow; of tokens and cost, by their mean so far.

        Args:
            active: Number of open requests, whose tokens are not counted yet.
        """
        limits = self._options
        left = math.inf if limits.max_calls is None else limits.max_calls - self.requests
        for most, used in ((limits.max_tokens, self.tokens), (limits.max_cost, self.cost)):
            if most is not None:  # one flight goes ahead until an answer shows what answers use
                left = min(left, (most - used) * self.answers / used - active if used else 0)
        return left


@dataclass(eq=False)
class Sent:
    """A request that may be sent.

    Attributes:
        at: When it is sent.
        round: The round that it belongs to.
    """

    at: float
    round: Round


def added(*counts: int | None) -> int | None:
    """The sum of the known counts; None if none is known."""
    known = [count for count in counts if count is not None]
    return sum(known) if known else None


class RateLimiter:
    """Decides when a request of a run is sent.

    The waiting request of the lowest-numbered flight goes first. Under a limit of calls, tokens or cost, a flight waits
    until the budget suffices for all flights before it, so that a budget ends as many flights as it can.

    Args:
        options: Limits, rate, prices and maximum concurrency.
        now: Returns monotonic seconds.
        sleep: Waits for seconds.

    Attributes:
        budget: The requests and tokens so far.
        active: Number of open requests.
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
        self._next_request = self._paused_until = 0.0
        self._halved_at = -1.0
        self._slowest: float | None = None
        self._waiting: list[tuple[int, int, bool, asyncio.Future[Sent]]] = []
        self._numbers = itertools.count()
        self._timer: asyncio.Future[None] | None = None
        self._turn: dict[int, int] = {}
        """The turn that each flight asks for."""
        self._turns = 0
        """Turns with a request."""
        self._flying: set[int] = set()
        self.begin(FIRST_CONCURRENCY, options.concurrency, 1)

    def begin(self, first: int, flights: int, longest: int, turns: int = 0) -> None:
        """Set what is known about a run.

        Args:
            first: Number of requests at once before the first answer.
            flights: Number of flights.
            longest: Turns of the longest flight.
            turns: Turns that earlier parts asked for.
        """
        self._search = ConcurrencySearch(first, min(self.options.concurrency, flights))
        self._longest = longest
        self._turns = turns

    @property
    def limit(self) -> int:
        """Current maximum number of open requests."""
        return self._search.limit

    @asynccontextmanager
    async def slot(self, flight: int = 0, turn: int = 1) -> AsyncGenerator[Sent, None]:
        """Wait until a request for a turn of a flight may be sent, count it, and hold its slot during the `with`.

        Raises:
            LimitReachedError: if the budget is spent.
        """
        is_new = self._turn.get(flight) != turn
        self._turn[flight] = turn
        admitted: asyncio.Future[Sent] = asyncio.get_running_loop().create_future()
        heapq.heappush(self._waiting, (flight, next(self._numbers), is_new, admitted))
        self._admit()
        try:
            sent = await admitted
        except asyncio.CancelledError:
            if not admitted.cancelled() and admitted.exception() is None:
                self._close(admitted.result())
            raise
        try:
            sent.at = self.now()
            yield sent
        finally:
            self._close(sent)

    def _admit(self) -> None:
        """Admit the waiting requests that may be sent now."""
        while self._waiting and self.active < self.limit:
            flight, _, is_new, admitted = self._waiting[0]
            error = self.budget.spent()
            if error is None and not admitted.done():
                now = self.now()
                if not self._affordable(flight):
                    return
                if (wait := max(self._paused_until, self._next_request) - now) > 0:
                    if self._timer is None:
                        self._timer = asyncio.ensure_future(self._admit_after(wait))
                    return
                # After an idle time, one request may follow without a gap.
                gap = 60 / (self.options.requests_per_minute or math.inf)
                self._next_request = max(self._next_request, now - gap) + gap
                self.active += 1
                self.budget.requests += 1
                self._turns += is_new
                self._flying.add(flight)
                admitted.set_result(Sent(now, self._search.sent(self.active)))
            elif not admitted.done():
                admitted.set_exception(LimitReachedError(error))
            heapq.heappop(self._waiting)

    async def _admit_after(self, seconds: float) -> None:
        await self.sleep(seconds)
        self._timer = None
        self._admit()

    def _affordable(self, flight: int) -> bool:
        """Whether the budget suffices for the longest possible rest of all flights before this one.

        A turn takes as many requests as the turns so far, with retries and repairs.
        """
        left = self.budget.calls_left(self.active)
        if left == math.inf:
            return True
        turns = sum(self._longest - self._turn[number] + 1 for number in self._flying if number < flight)
        return turns == 0 or left > turns * max(1.0, self.budget.requests / max(1, self._turns))

    def _close(self, sent: Sent) -> None:
        self.active -= 1
        self._search.closed(sent.round)
        self._admit()

    def ended(self, flight: int) -> None:
        """Free the budget that was kept for a flight."""
        self._flying.discard(flight)
        self._admit()

    def answered(self, sent: Sent, answer: "Answer") -> float:
        """Measure the seconds of an answer, and return them."""
        seconds = self.now() - sent.at
        self._slowest = max(seconds, self._slowest or 0.0)
        sent.round.seconds += seconds
        # About 4 letters are a token. Not every endpoint counts them, or those of the reasoning.
        letters = sum(len(text or "") for text in (answer.text, answer.reasoning, answer.tool_arguments))
        sent.round.tokens += PROMPT_TOKENS + max(answer.completion_tokens or 0, letters / 4)
        return seconds

    def failed(self, sent: Sent, pause: float, overload: bool) -> None:
        """Send nothing during a pause, and allow half as many requests at once if too many fail.

        Args:
            sent: The failed request; those from before the last halving do not halve again.
            pause: Seconds.
            overload: Whether it failed because the endpoint has too many.
        """
        self._paused_until = max(self._paused_until, self.now() + pause)
        if sent.at > self._halved_at:
            before = self.limit
            self._search.failed(overload)
            if self.limit < before:
                self._halved_at = self.now()

    async def abandoned(self) -> None:
        """Wait as long as a server may still work on a request that timed out.

        That is as long as its slowest answer took, or once more the time limit if there was none.
        """
        timeout = self.options.timeout
        await self.sleep(timeout if self._slowest is None else min(timeout, self._slowest))
