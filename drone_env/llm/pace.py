"""How many requests and tokens a minute go to an endpoint."""

import asyncio

from drone_env.errors import InvalidValueError
from drone_env.llm.clock import Clock


class Pace:
    """Lets one request after another go, evenly spaced.

    How many tokens a request takes is known when its answer is there; until then it counts as many as requests took on
    average so far.

    Args:
        requests: The most a minute; None for no limit.
        tokens: The same.
        clock: Tells the time, and waits.
    """

    def __init__(self, requests: float | None = None, tokens: float | None = None, clock: Clock | None = None) -> None:
        for name, value in (("requests", requests), ("tokens", tokens)):
            if value is not None and not 0 < value < float("inf"):
                raise InvalidValueError(f"--{name}-per-minute must be above 0, got {value}")
        self._seconds_per_request = 0.0 if requests is None else 60 / requests
        self._seconds_per_token = 0.0 if tokens is None else 60 / tokens
        self._next_request = 0.0
        self._next_token = 0.0
        self._mean_tokens = 0.0
        self._answers = 0
        self._turn = asyncio.Lock()
        self._clock = clock or Clock()

    async def turn(self, seconds_left: float) -> float:
        """Wait until a request may go, at most so many seconds, and return for how many tokens it counts."""
        async with self._turn:
            ends = self._clock.now() + seconds_left
            while (wait := min(max(self._next_request, self._next_token), ends) - self._clock.now()) > 0:
                await self._clock.sleep(wait)
            now, expected = self._clock.now(), self._mean_tokens
            self._next_request = max(self._next_request, now - self._seconds_per_request) + self._seconds_per_request
            self._use(expected)
            return expected

    def used(self, tokens: int, expected: float) -> None:
        """An answer took so many tokens, where so many were expected."""
        self._answers += 1
        self._mean_tokens += (tokens - self._mean_tokens) / self._answers
        self._use(tokens - expected)

    def unused(self, expected: float) -> None:
        """A request for which so many tokens were expected brought no answer."""
        self._use(-expected)

    def _use(self, tokens: float) -> None:
        self._next_token = max(self._next_token, self._clock.now()) + tokens * self._seconds_per_token
