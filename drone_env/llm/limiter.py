"""The rate limiter of a run: how many requests at once and per minute, the first flights first.

`ConcurrencySearch` finds the number of requests at once that an endpoint can use. A limit on latency alone would not
do: answers differ in length by a factor of ten, and the first answer of a local server waits for its model to load. So
the search compares neighbours, per token, again and again.
"""

import asyncio
import heapq
import itertools
import math
from collections import Counter
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from drone_env.llm.answers import Answer
from drone_env.llm.budget import Budget, LimitReachedError

SMALL, LARGE = 4, 16
"""Fewest and most requests that measure a number of requests at once."""
LATE = 0.25
"""Share of them that need not have an answer: a few answers take many times longer than the others."""
MAX_FAILED = 0.1
"""Share of failed requests that counts as an overload."""
MIN_GAIN = 1.2
"""Throughput that twice as many requests at once must bring."""
MAX_REST = 16
"""Most rounds until a number that was no better is tried again."""
PROMPT_TOKENS = 32
"""Tokens of an answer that take about as long as its request and its prompt."""


@dataclass(eq=False)
class Round:
    """Requests that were all sent under one limit, and the time that their answers took.

    Attributes:
        early: Number of requests to leave out, until the endpoint has as many as the limit allows.
        unsent: Number of requests still to send.
        late: Number of its requests that may be open at its end.
        open: Number of its open requests.
        failed: Number of failed requests under its limit, in this round or not.
        peak: Largest number of requests at once.
        seconds: Seconds of its answers.
        tokens: Tokens of its answers.
    """

    early: int
    unsent: int
    late: int
    open: int = 0
    failed: int = 0
    peak: int = 0
    seconds: float = 0.0
    tokens: float = 0.0


class ConcurrencySearch:
    """Searches the smallest number of requests at once that brings the most answers.

    A server that answers one request at a time takes twice as long for two; a server that batches does not. A round
    measures the seconds per token under one limit. Twice as many requests must raise the throughput by `MIN_GAIN`, else
    half as many are enough. An overload is no gain. A limit that was no better is tried again after 4, 8 and then every
    16 rounds, since one round can mislead, and endpoints change.

    Args:
        first: The first limit.
        most: The highest one.

    Attributes:
        limit: Maximum number of open requests.
    """

    def __init__(self, first: int, most: int) -> None:
        self._most = most
        self._seconds: dict[int, float] = {}
        """Seconds per token by limit; infinite if it overloads the endpoint."""
        self._expiry: dict[int, int] = {}
        """The round from which the seconds of a limit are out of date."""
        self._rejected: Counter[int] = Counter()
        self._rounds = 0
        self._begin(min(first, most), early=min(first, most))

    def _begin(self, limit: int, early: int = 0) -> None:
        self.limit = limit
        size = min(max(limit, SMALL), LARGE)
        self._round = Round(early, size, late=int(LATE * size))

    def sent(self, active: int) -> Round:
        """The round of a request, the last of `active` open requests; one of its own if it is not measured."""
        now = self._round
        now.peak = max(now.peak, active)
        if now.early or not now.unsent:
            now.early -= now.early > 0
            return Round(0, 0, 0)
        now.unsent -= 1
        now.open += 1
        return now

    def closed(self, of: Round) -> None:
        """Count a request that is no longer open; decide after the last one of a round."""
        of.open -= 1
        if of is not self._round or of.open > of.late or of.unsent:
            return
        if of.peak < self.limit or not of.tokens:
            # Too few flights or answers to judge this limit.
            self._begin(self.limit)
            return
        self._rounds += 1
        self._choose(of.seconds / of.tokens)

    def _choose(self, seconds: float) -> None:
        """Choose the next limit, after a round with these seconds per token."""
        lower, limit, upper = self._lower(), self.limit, min(2 * self.limit, self._most)
        last = self._seconds.get(limit, math.inf)
        self._seconds[limit] = seconds if last == math.inf else (seconds + last) / 2
        for other in {lower, upper} - {limit}:
            if self._expiry.get(other, 0) <= self._rounds:
                self._seconds.pop(other, None)
        known = self._seconds
        if lower in known and not self._pays(lower, limit):
            self._move(lower)
        elif upper != limit and (upper not in known or self._pays(limit, upper)):
            self._move(upper)
        elif lower not in known:
            self._move(lower)
        else:
            self._rejected[limit] = 0
            self._begin(limit)

    def failed(self, overload: bool) -> None:
        """Halve the limit if a request failed by an overload, or too many failed."""
        self._round.failed += 1
        if not overload and self._round.failed <= MAX_FAILED * self.limit:
            return
        if self.limit == 1:
            self._begin(1)
            return
        self._seconds[self.limit] = math.inf
        self._move(self._lower())

    def _lower(self) -> int:
        """The power of two below the limit; 1 if it is 1."""
        return 1 << max(0, (self.limit - 1).bit_length() - 1)

    def _pays(self, few: int, many: int) -> bool:
        gain = MIN_GAIN ** math.log2(many / few)
        return many * self._seconds[few] >= few * self._seconds[many] * gain

    def _move(self, limit: int) -> None:
        left, rest = self.limit, MAX_REST
        if limit < left:
            self._rejected[left] += 1
            rest = min(MAX_REST, 2 << self._rejected[left])
        self._expiry[left] = self._rounds + rest
        self._begin(limit, early=max(0, limit - left))


@dataclass(eq=False)
class Sent:
    """A request that may be sent.

    Attributes:
        at: When it is sent.
        round: The round that it belongs to.
    """

    at: float
    round: Round


def now() -> float:
    """The seconds of the running event loop, which only grow."""
    return asyncio.get_running_loop().time()


class RateLimiter:
    """Decides when a request of a run is sent.

    The waiting request of the lowest-numbered flight goes first. Under a limit of calls, tokens or cost, a flight waits
    until the budget suffices for all flights before it, so that a budget ends as many flights as it can.

    Args:
        budget: The requests and tokens so far, and the options.
        first: Number of requests at once before the first answer.
        most: Maximum number of requests at once.
        longest: Turns of the longest flight.
        turns: Turns that earlier parts of the run asked for.

    Attributes:
        active: Number of open requests.
    """

    def __init__(self, budget: Budget, first: int, most: int, longest: int = 1, turns: int = 0) -> None:
        self.budget, self.options, self.active = budget, budget.options, 0
        self._search = ConcurrencySearch(first, most)
        self._longest, self._turns = longest, turns
        self._next_request = self._paused_until = 0.0
        self._halved_at = -1.0
        self._slowest: float | None = None
        self._waiting: list[tuple[int, int, bool, asyncio.Future[Sent]]] = []
        self._numbers = itertools.count()
        self._timer: asyncio.Future[None] | None = None
        self._turn: dict[int, int] = {}
        """The turn that each flight asks for."""
        self._flying: set[int] = set()

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
            sent.at = now()
            yield sent
        finally:
            self._close(sent)

    def _admit(self) -> None:
        """Admit the waiting requests that may be sent now."""
        while self._waiting and self.active < self.limit:
            flight, _, is_new, admitted = self._waiting[0]
            error = self.budget.spent() if self.budget.limited else None
            if error is None and not admitted.done():
                at = now()
                if not self._affordable(flight):
                    return
                if (wait := max(self._paused_until, self._next_request) - at) > 0:
                    if self._timer is None:
                        self._timer = asyncio.ensure_future(self._admit_after(wait))
                    return
                # After an idle time, one request may follow without a gap.
                gap = 60 / (self.options.requests_per_minute or math.inf)
                self._next_request = max(self._next_request, at - gap) + gap
                self.active += 1
                self.budget.requests += 1
                self._turns += is_new
                self._flying.add(flight)
                admitted.set_result(Sent(at, self._search.sent(self.active)))
            elif not admitted.done():
                admitted.set_exception(LimitReachedError(error))
            heapq.heappop(self._waiting)

    async def _admit_after(self, seconds: float) -> None:
        await asyncio.sleep(seconds)
        self._timer = None
        self._admit()

    def _affordable(self, flight: int) -> bool:
        """Whether the budget suffices for the longest possible rest of all flights before this one.

        A turn takes as many requests as the turns so far, with retries and repairs.
        """
        if not self.budget.limited:
            return True
        left = self.budget.calls_left(self.active)
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

    def answered(self, sent: Sent, answer: Answer) -> float:
        """Measure the seconds of an answer, and return them."""
        seconds = now() - sent.at
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
        self._paused_until = max(self._paused_until, now() + pause)
        if sent.at > self._halved_at:
            before = self.limit
            self._search.failed(overload)
            if self.limit < before:
                self._halved_at = now()

    async def abandoned(self) -> None:
        """Wait as long as a server may still work on a request that timed out.

        That is as long as its slowest answer took, or once more the time limit if there was none.
        """
        timeout = self.options.timeout
        await asyncio.sleep(timeout if self._slowest is None else min(timeout, self._slowest))
