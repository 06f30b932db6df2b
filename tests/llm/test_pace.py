"""How many requests and tokens a minute go out, and how many at once, by a clock that only waiting moves."""

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from drone_env.llm.limiter import LimitReachedError, Pace, RateLimiter
from drone_env.llm.options import Options

from .conftest import Endpoint
from .virtual_time import VirtualClock, fly


def grants(n: int, used: int, pace: Callable[[VirtualClock], Pace], idle: float = 0.0) -> list[float]:
    """When each of `n` requests went that took so many tokens; before the last nothing is sent for `idle` seconds."""
    clock = VirtualClock()
    found: list[float] = []

    async def ask() -> None:
        asked = pace(clock)
        for number in range(n):
            clock.time += idle if number == n - 1 else 0
            expected = await asked.turn(math.inf)
            found.append(clock.passed)
            asked.used(used, expected)

    asyncio.run(ask())
    return found


def test_requests_a_minute() -> None:
    def pace(clock: VirtualClock) -> Pace:
        return Pace(requests=1200, clock=clock)

    # 20 a second; one gap may be made up for, and no more than one, however long nothing was sent.
    assert grants(6, 50, pace) == pytest.approx([0, 0, 0.05, 0.1, 0.15, 0.2])
    assert grants(4, 50, pace, idle=9) == pytest.approx([0, 0, 0.05, 9.05])
    assert grants(6, 50, lambda clock: Pace(clock=clock)) == [0] * 6


def test_tokens_a_minute() -> None:
    def pace(clock: VirtualClock) -> Pace:
        return Pace(tokens=60_000, clock=clock)

    # 50 tokens each, at 1,000 a second.
    assert grants(6, 50, pace) == pytest.approx([0, 0.05, 0.1, 0.15, 0.2, 0.25])
    both = grants(5, 50, lambda clock: Pace(requests=60, tokens=60_000, clock=clock))
    assert both == pytest.approx([0, 0.05, 1, 2, 3])


def test_what_brings_no_answer_takes_no_tokens() -> None:
    clock = VirtualClock()

    async def ask() -> None:
        pace = Pace(tokens=60_000, clock=clock)
        pace.used(100, await pace.turn(math.inf))
        expected = await pace.turn(math.inf)
        assert (clock.passed, expected) == (pytest.approx(0.1), 100)
        pace.used(None, expected)
        await pace.turn(math.inf)
        assert clock.passed == pytest.approx(0.1)
        # It counts until its answer is there.
        await pace.turn(math.inf)
        assert clock.passed == pytest.approx(0.2)

    asyncio.run(ask())


def test_a_run_keeps_the_pace(endpoint: Callable[..., Endpoint]) -> None:
    scripted = endpoint(pilot="WAIT")
    flown = fly(scripted.url, scripted.folder / "run", Options(requests_per_minute=60))
    # The second goes with the first.
    assert (flown.turns, flown.clock.passed) == (["ok"] * 60, pytest.approx(58))
    # 102 tokens each, at 51 a second.
    flown = fly(scripted.url, scripted.folder / "tokens", Options(tokens_per_minute=3060))
    assert (flown.turns, flown.clock.passed) == (["ok"] * 60, pytest.approx(118))


def test_a_request_that_fails_leaves_its_tokens_to_the_next(endpoint: Callable[..., Endpoint]) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 1, {"status": 500}]])
    options = Options(tokens_per_minute=6120, backoff=0)
    flown = fly(scripted.url, scripted.folder / "run", options)
    # Three answers of a second's worth of tokens each: the third waits for two of them.
    assert (flown.turns, flown.clock.passed) == (["ok"] * 3, pytest.approx(2))


def with_limiter(most: int, work: Callable[[RateLimiter, VirtualClock], Awaitable[Any]], **limits: Any) -> None:
    async def run() -> None:
        clock = VirtualClock()
        await work(RateLimiter(Options(concurrency=most, **limits), clock), clock)

    asyncio.run(run())


def test_concurrency_grows_with_answers_and_halves_under_load() -> None:
    async def work(limiter: RateLimiter, clock: VirtualClock) -> None:
        async def send(overloaded: bool = False) -> None:
            clock.time += overloaded
            async with limiter.slot() as slot:
                slot.tokens, slot.overloaded = 0, overloaded

        async def send_all(n: int) -> None:
            for _ in range(n):
                await send()

        assert limiter.limit == 8
        await send_all(8)
        assert limiter.limit == 16
        async with limiter.slot() as slot:
            await send(overloaded=True)
            assert limiter.limit == 8
            slot.overloaded = True  # sent before the last halving
        assert limiter.limit == 8
        # From now on one more after a round of answers.
        await send_all(8)
        assert 8.9 < limiter.limit < 9
        for _ in range(10):
            await send(overloaded=True)
        assert limiter.limit == 1
        await send_all(10_000)
        assert limiter.limit == 100

    with_limiter(100, work)


def test_the_limiter_bounds_the_requests_at_once() -> None:
    async def work(limiter: RateLimiter, clock: VirtualClock) -> None:
        most = passed = 0

        async def one() -> None:
            nonlocal most, passed
            async with limiter.slot():
                most = max(most, limiter.active)
                await asyncio.sleep(0)
                passed += 1

        await asyncio.gather(*(one() for _ in range(50)))
        assert (most, passed, limiter.active) == (3, 50, 0)

    with_limiter(3, work)


def test_an_overloaded_endpoint_gets_a_pause_within_the_time_of_the_run() -> None:
    async def work(limiter: RateLimiter, clock: VirtualClock) -> None:
        async def send(pause: float | None = None) -> None:
            async with limiter.slot() as slot:
                slot.overloaded, slot.pause = pause is not None, pause or 0

        async with limiter.slot() as slot:
            slot.overloaded, slot.pause = True, 7
            await send(pause=2)  # the longer pause holds
        await send()
        assert clock.slept == [7]
        await send(pause=60)
        with pytest.raises(LimitReachedError, match="10 s have passed"):
            await send()
        assert (clock.slept, limiter.active) == ([7, 3], 0)

    with_limiter(8, work, max_seconds=10)


def test_a_slot_that_nobody_waits_for_any_more_goes_to_the_next() -> None:
    async def work(limiter: RateLimiter, clock: VirtualClock) -> None:
        async def hold() -> None:
            async with limiter.slot():
                await asyncio.sleep(3600)

        async with limiter.slot():
            second, third = asyncio.ensure_future(hold()), asyncio.ensure_future(hold())
            await asyncio.sleep(0)
        # The second one is stopped before it takes the free slot.
        second.cancel()
        for _ in range(5):
            await asyncio.sleep(0)
        assert second.cancelled()
        assert limiter.active == 1
        third.cancel()
        await asyncio.gather(third, return_exceptions=True)
        assert limiter.active == 0

    with_limiter(1, work)
