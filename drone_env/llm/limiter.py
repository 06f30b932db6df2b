"""The rate limiter of a run: how many requests at once and per minute."""

import asyncio
import math
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from drone_env.llm.budget import Budget, LimitReachedError


def now() -> float:
    """The seconds of the running event loop, which only grow."""
    return asyncio.get_running_loop().time()


class RateLimiter:
    """Decides when a request of a run is sent: the one that has waited longest goes first.

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
