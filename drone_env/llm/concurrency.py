"""How many requests are under way at once: more while all goes well, half as many when the endpoint is overloaded."""

import asyncio
from collections import deque
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from drone_env.llm.clock import Clock

FIRST = 8


class AdaptiveGate:
    """Lets requests through: additive increase, multiplicative decrease, with a fast start, as TCP does.

    Args:
        most: The most requests at once.
        clock: Tells the time, and waits.
    """

    def __init__(self, most: int, clock: Clock | None = None) -> None:
        self.most = most
        self.limit = float(min(FIRST, most))
        self.active = 0
        self._fast = True
        self._closed_until = 0.0
        self._halved_at = -1.0
        self._clock = clock or Clock()
        self._waiting: deque[asyncio.Future[None]] = deque()

    @asynccontextmanager
    async def passing(self) -> AsyncGenerator[None, None]:
        """Wait for a place, and hold it inside of the `with`."""
        while (pause := self._closed_until - self._clock.now()) > 0 or self.active >= int(self.limit):
            if pause > 0:
                await self._clock.sleep(pause)
                continue
            place: asyncio.Future[None] = asyncio.get_running_loop().create_future()
            self._waiting.append(place)
            try:
                await place
            except asyncio.CancelledError:
                self._wake()
                raise
        self.active += 1
        try:
            yield
        finally:
            self.active -= 1
            self._wake()

    def succeeded(self) -> None:
        """An answer came: let more through."""
        grown = self.limit + (1 if self._fast else 1 / self.limit)
        self.limit = min(float(self.most), grown)
        self._wake()

    def overloaded(self, sent_at: float, pause: float = 0.0) -> None:
        """The endpoint could not keep up: let half as many through.

        Args:
            sent_at: when the request was sent, by the clock: of those sent before the last halving none counts.
            pause: Seconds in which nothing is sent.
        """
        self._fast = False
        self._closed_until = max(self._closed_until, self._clock.now() + pause)
        if sent_at > self._halved_at:
            self.limit = max(1.0, self.limit / 2)
            self._halved_at = self._clock.now()

    def _wake(self) -> None:
        free = int(self.limit) - self.active
        while free > 0 and self._waiting:
            place = self._waiting.popleft()
            if not place.done():
                place.set_result(None)
                free -= 1
