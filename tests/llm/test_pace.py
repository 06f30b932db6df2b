"""How many requests and tokens a minute go out, and how many at once, by a clock that only waiting moves."""

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.gate import Gate, Pace
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


def test_nobody_waits_for_a_turn_longer_than_the_run_lasts() -> None:
    clock = VirtualClock()

    async def ask() -> None:
        pace = Pace(requests=1, clock=clock)
        for _ in range(3):
            await pace.turn(7)
        assert clock.slept == [7]

    asyncio.run(ask())


def test_what_is_no_pace_is_refused() -> None:
    for wrong in ({"requests": 0}, {"tokens": math.nan}, {"requests": math.inf}):
        with pytest.raises(InvalidValueError, match="per-minute must be above 0"):
            Options(**{f"{name}_per_minute": value for name, value in wrong.items()})


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


def at_gate(most: int, work: Callable[[Gate, VirtualClock], Awaitable[Any]]) -> None:
    async def run() -> None:
        clock = VirtualClock()
        await work(Gate(Options(concurrency=most), clock), clock)

    asyncio.run(run())


def test_the_gate_grows_with_answers_and_halves_under_load() -> None:
    async def work(gate: Gate, clock: VirtualClock) -> None:
        assert gate.limit == 8
        for _ in range(8):
            gate.answered()
        assert gate.limit == 16
        clock.time += 1
        gate.overloaded(sent_at=clock.time)
        assert gate.limit == 8
        gate.overloaded(sent_at=clock.time - 0.5)  # sent before the last halving
        assert gate.limit == 8
        # From now on one more when all of a round were answered.
        for _ in range(8):
            gate.answered()
        assert 8.9 < gate.limit < 9
        for _ in range(10):
            clock.time += 1
            gate.overloaded(sent_at=clock.time)
        assert gate.limit == 1
        for _ in range(10_000):
            gate.answered()
        assert gate.limit == 100

    at_gate(100, work)


def test_so_many_pass_the_gate_at_once_and_no_more() -> None:
    async def work(gate: Gate, clock: VirtualClock) -> None:
        most = passed = 0

        async def one(flight: int) -> None:
            nonlocal most, passed
            await gate.acquire(flight)
            most = max(most, gate.active)
            await asyncio.sleep(0)
            passed += 1
            gate.release(flight, None)

        await asyncio.gather(*map(one, range(50)))
        assert (most, passed, gate.active) == (3, 50, 0)

    at_gate(3, work)


def test_the_gate_is_closed_for_as_long_as_the_endpoint_asks() -> None:
    async def work(gate: Gate, clock: VirtualClock) -> None:
        gate.overloaded(sent_at=clock.time, pause=5)
        gate.overloaded(sent_at=clock.time, pause=2)
        await gate.acquire(0)
        assert clock.slept == [5]

    at_gate(8, work)


def test_a_place_that_nobody_waits_for_any_more_goes_to_the_next() -> None:
    async def work(gate: Gate, clock: VirtualClock) -> None:
        await gate.acquire(1)
        second, third = asyncio.ensure_future(gate.acquire(2)), asyncio.ensure_future(gate.acquire(3))
        await asyncio.sleep(0)
        gate.release(1, None)
        # The place has been given to the second one, which is stopped before it takes it.
        second.cancel()
        for _ in range(5):
            await asyncio.sleep(0)
        assert second.cancelled()
        assert (third.done(), gate.active) == (True, 1)
        gate.release(3, None)
        assert gate.active == 0

    at_gate(1, work)
