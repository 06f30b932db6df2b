"""What time it is, and waiting: in one place, so that a test can bring a clock of its own."""

import asyncio
import time


class Clock:
    """The machine's clock."""

    def now(self) -> float:
        """Seconds since some moment, which never go back."""
        return time.monotonic()

    async def sleep(self, seconds: float) -> None:
        """Wait."""
        await asyncio.sleep(seconds)
