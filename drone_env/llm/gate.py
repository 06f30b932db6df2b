"""What lets requests through: as many at once and a minute as the endpoint bears, as long as the run may pay."""

import asyncio
import time
from collections import deque
from dataclasses import dataclass

from drone_env.errors import DroneEnvError, EndpointError
from drone_env.llm.options import Options
from drone_env.llm.transcript import Call

FIRST = 8
"""The most requests at once before any answer came."""


class LimitReachedError(DroneEnvError):
    """A run has spent what it may."""


class StoppedError(DroneEnvError):
    """The run is being stopped: this flight is left where it is."""


class Clock:
    """The machine's clock, in one place, so that a test can bring a clock of its own."""

    def now(self) -> float:
        """Seconds since some moment, which never go back."""
        return time.monotonic()

    async def sleep(self, seconds: float) -> None:
        """Wait."""
        await asyncio.sleep(seconds)


class Pace:
    """Lets one request after another go, evenly spaced.

    How many tokens a request takes is known when its answer is there; until then it counts as many as requests took on
    average so far.

    Args:
        clock: Gives the time, and waits.
        requests: The most a minute; None for no limit.
        tokens: The same.
    """

    def __init__(self, clock: Clock, requests: float | None = None, tokens: float | None = None) -> None:
        self._seconds_per_request = 0.0 if requests is None else 60 / requests
        self._seconds_per_token = 0.0 if tokens is None else 60 / tokens
        self._next_request = 0.0
        self._next_token = 0.0
        self._mean_tokens = 0.0
        self._answers = 0
        self._turn = asyncio.Lock()
        self._clock = clock

    async def turn(self, seconds_left: float) -> float:
        """Wait until a request may go, at most this many seconds, and return for how many tokens it counts."""
        async with self._turn:
            ends = self._clock.now() + seconds_left
            while (wait := min(max(self._next_request, self._next_token), ends) - self._clock.now()) > 0:
                await self._clock.sleep(wait)
            now, expected = self._clock.now(), self._mean_tokens
            self._next_request = max(self._next_request, now - self._seconds_per_request) + self._seconds_per_request
            self._use(expected)
            return expected

    def used(self, tokens: int | None, expected: float) -> None:
        """Count what a request took where `expected` tokens were reserved; None where it brought no answer."""
        if tokens is not None:
            self._answers += 1
            self._mean_tokens += (tokens - self._mean_tokens) / self._answers
        self._use((tokens or 0) - expected)

    def _use(self, tokens: float) -> None:
        self._next_token = max(self._next_token, self._clock.now()) + tokens * self._seconds_per_token


@dataclass
class _Place:
    """A request: whether it has been let in, when it was sent, and for how many tokens it counts."""

    inside: bool = False
    sent_at: float = 0.0
    tokens: float = 0.0


class Gate:
    """Lets the requests of a run through, one at a time for each flight.

    How many are under way at once grows and shrinks as in TCP: a fast start, one more when all of a round were
    answered, half as many when the endpoint is overloaded.

    Args:
        options: Limits, pace, prices and the most requests at once.
        clock: Gives the time, and waits.

    Attributes:
        requests, cached: Requests sent, and answers from the cache.
        prompt_tokens, completion_tokens: What answers took.
        active: Requests under way.
        limit: The most requests at once, now.
        fatal: Why no further request makes sense; None while they do.
    """

    def __init__(self, options: Options, clock: Clock | None = None) -> None:
        self.options = options
        self.clock = clock or Clock()
        self.requests = self.cached = self.prompt_tokens = self.completion_tokens = self.active = 0
        self.limit = float(min(FIRST, options.concurrency))
        self.fatal: EndpointError | None = None
        self._started = self.clock.now()
        self._pace = Pace(self.clock, options.requests_per_minute, options.tokens_per_minute)
        self._unmetered = 0
        self._fast = True
        self._closed_until = 0.0
        self._halved_at = -1.0
        self._waiting: deque[asyncio.Future[None]] = deque()
        self._places: dict[int, _Place] = {}

    @property
    def tokens(self) -> int:
        """All tokens that were paid."""
        return self.prompt_tokens + self.completion_tokens

    @property
    def cost(self) -> float | None:
        """US dollars; None where no price is known."""
        prices = self.options.prices
        return None if prices is None else prices.cost(self.prompt_tokens, self.completion_tokens)

    @property
    def seconds_left(self) -> float:
        """Until the time of the run is over."""
        limit = self.options.max_seconds
        return float("inf") if limit is None else max(0.0, limit - (self.clock.now() - self._started))

    def count(self, call: Call, counted: int = 0) -> None:
        """Count what a call took, `counted` of whose requests have been counted already."""
        self.requests += call.requests - counted
        self.cached += call.cached
        if call.answer is None or call.cached:
            return
        if call.answer.prompt_tokens is None or call.answer.completion_tokens is None:
            self._unmetered += 1
        self.prompt_tokens += call.answer.prompt_tokens or 0
        self.completion_tokens += call.answer.completion_tokens or 0

    async def acquire(self, flight: int) -> float:
        """Wait until a request of a flight may be sent, count it, and return the seconds that are left to the run.

        Raises:
            StoppedError: if the run is being stopped, or the flight has begun again elsewhere.
            LimitReachedError: if it must not be sent.
        """
        place = self._places[flight] = _Place()
        try:
            await self._room()
            self._check_current(flight, place)
            place.inside = True
            self.active += 1
            place.tokens = await self._pace.turn(self.seconds_left)
            self._check_current(flight, place)
            self.check_going_on()
            self._check_limits()
        except BaseException:
            if self._places.get(flight) is place:
                self.leave(flight)
            self._wake()
            raise
        self.requests += 1
        place.sent_at = self.clock.now()
        return self.seconds_left

    def release(self, flight: int, tokens: int | None, overloaded: bool = False, pause: float = 0.0) -> None:
        """The request of a flight is over.

        Args:
            flight: Which one; nothing is done where it has begun again elsewhere.
            tokens: How many its answer took; None where none came.
            overloaded: Whether the endpoint could not keep up.
            pause: Seconds in which it is sent nothing.
        """
        place = self._places.get(flight)
        if place is None:
            return
        if overloaded:
            self.overloaded(place.sent_at, min(pause, self.seconds_left))
        elif tokens is not None:
            self.answered()
        self._pace.used(tokens, place.tokens)
        self.leave(flight)

    def leave(self, flight: int) -> None:
        """The flight begins again elsewhere, or its request is over: its place is free."""
        place = self._places.pop(flight, None)
        if place is not None and place.inside:
            self.active -= 1
            self._wake()

    def answered(self) -> None:
        """An answer came: let more through."""
        grown = self.limit + (1 if self._fast else 1 / self.limit)
        self.limit = min(float(self.options.concurrency), grown)
        self._wake()

    def overloaded(self, sent_at: float, pause: float = 0.0) -> None:
        """The endpoint could not keep up: let half as many through.

        Args:
            sent_at: When the request was sent, by the clock: of those sent before the last halving none counts.
            pause: Seconds in which nothing is sent.
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

    async def _room(self) -> None:
        while (pause := self._closed_until - self.clock.now()) > 0 or self.active >= int(self.limit):
            if pause > 0:
                await self.clock.sleep(pause)
                continue
            turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._waiting.append(turn)
            await turn

    def _wake(self) -> None:
        free = int(self.limit) - self.active
        while free > 0 and self._waiting:
            turn = self._waiting.popleft()
            if not turn.done():
                turn.set_result(None)
                free -= 1

    def _check_current(self, flight: int, place: _Place) -> None:
        if self._places.get(flight) is not place:
            raise StoppedError("the flight has begun again elsewhere")

    def _check_limits(self) -> None:
        limits, cost = self.options, self.cost
        if limits.max_calls is not None and self.requests >= limits.max_calls:
            raise LimitReachedError(f"all {limits.max_calls} calls have been made")
        if limits.max_seconds is not None and self.seconds_left == 0:
            raise LimitReachedError(f"{limits.max_seconds:g} s have passed")
        if self._unmetered and (limits.max_tokens is not None or limits.max_cost is not None):
            raise LimitReachedError("the endpoint does not say how many tokens it used, so they cannot be limited")
        if limits.max_tokens is not None and self.tokens >= limits.max_tokens:
            raise LimitReachedError(f"{self.tokens} of {limits.max_tokens} tokens have been used")
        if limits.max_cost is not None and cost is not None and cost >= limits.max_cost:
            raise LimitReachedError(f"{cost:.4f} of {limits.max_cost:g} US dollars have been spent")
