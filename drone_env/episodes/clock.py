"""The time by which sessions are idle."""

import time
from collections.abc import Callable


def steady_clock(
    wall: Callable[[], float] = time.time, steady: Callable[[], float] = time.monotonic
) -> Callable[[], float]:
    """A clock that is right when it is made, in seconds since 1970, and neither jumps nor goes back.

    Args:
        wall: The machine's time, which people and programs set.
        steady: Seconds since whenever.
    """
    offset = wall() - steady()
    return lambda: steady() + offset
