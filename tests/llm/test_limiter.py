"""How many requests go out at once, per minute and in all, and when failed ones are repeated."""

import asyncio
import math
import random
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.answers import Answer
from drone_env.llm.budget import Budget, Options, RateLimiter, now
from drone_env.llm.endpoint import TryFailedError
from drone_env.llm.runner import MAX_BACKOFF, MAX_WAIT
from drone_env.llm.verify import verified_run

from .conftest import blocks
from .stored_run import BEGAN, Scripted, fly, in_virtual_time


def with_limiter(work: Callable[[RateLimiter], Awaitable[Any]], **options: Any) -> tuple[Any, float]:
    """The result of a function that gets a limiter, and the virtual seconds that it took."""

    async def run() -> Any:
        return await work(RateLimiter(Budget(Options(**options))))

    return in_virtual_time(run())


async def answered(limiter: RateLimiter) -> float:
    """Send a request that is answered at once; the seconds until it was sent."""
    async with limiter.slot():
        limiter.answered()
    return now() - BEGAN


@pytest.mark.parametrize(
    ("options", "idle", "expected"),
    [
        ({}, 0, [0, 0, 0, 0, 0]),
        # 20 requests a second; one gap may be made up for, however long nothing was sent.
        ({"requests_per_minute": 1200}, 0, [0, 0, 0.05, 0.1, 0.15]),
        ({"requests_per_minute": 1200}, 9, [0, 0, 0.05, 0.1, 9.1]),
    ],
)
def test_requests_per_minute(options: dict[str, float], idle: float, expected: list[float]) -> None:
    async def work(limiter: RateLimiter) -> list[float]:
        sent = [await answered(limiter) for _ in range(4)]
        await asyncio.sleep(idle)
        return [*sent, await answered(limiter)]

    assert with_limiter(work, **options)[0] == pytest.approx(expected)


def test_an_overload_halves_and_answers_bring_the_limit_back() -> None:
    async def work(limiter: RateLimiter) -> None:
        async def failed(overload: bool) -> int:
            await asyncio.sleep(1)
            async with limiter.slot() as sent:
                limiter.failed(sent, 0, overload)
            return limiter.limit

        assert await failed(overload=False) == 16
        assert await failed(overload=True) == 8
        async with limiter.slot() as sent:
            assert await failed(overload=True) == 4
            limiter.failed(sent, 0, overload=True)  # sent before the last halving
            assert limiter.limit == 4
        assert [await failed(overload=True) for _ in range(3)] == [2, 1, 1]
        limits = list[int]()
        for _ in range(140):
            await answered(limiter)
            limits.append(limiter.limit)
        assert (limits[0], limits[2], limits[5], limits[-1]) == (2, 3, 4, 16)

    with_limiter(work, concurrency=16)


def test_no_more_requests_are_open_than_the_limit_allows() -> None:
    async def work(limiter: RateLimiter) -> int:
        peaks = list[int]()

        async def one() -> None:
            async with limiter.slot():
                peaks.append(limiter.active)
                await asyncio.sleep(1)

        await asyncio.gather(*(one() for _ in range(10)))
        return max(peaks)

    assert with_limiter(work, concurrency=4) == (4, 3)


def test_an_overloaded_endpoint_gets_the_longest_pause_that_it_asked_for() -> None:
    async def work(limiter: RateLimiter) -> float:
        async with limiter.slot() as first, limiter.slot() as second:
            limiter.failed(first, 7, overload=True)
            limiter.failed(second, 2, overload=True)
        return await answered(limiter)

    assert with_limiter(work)[0] == 7


def test_waiting_requests_go_in_order_and_a_cancelled_one_leaves_its_place() -> None:
    async def work(limiter: RateLimiter) -> None:
        order: list[int] = []

        async def one(number: int) -> None:
            async with limiter.slot():
                order.append(number)

        # One is cancelled while it waits, and one when it is let in, before it begins.
        for numbers, cancelled, late in (((0, 1, 2, 3), 2, False), ((4, 5), 0, True)):
            async with limiter.slot():
                waiting = [asyncio.ensure_future(one(number)) for number in numbers]
                await asyncio.sleep(1)
                if not late:
                    waiting[cancelled].cancel()
            waiting[cancelled].cancel()
            await asyncio.wait(waiting)
        assert (order, limiter.active) == ([0, 1, 3, 5], 0)

    with_limiter(work, concurrency=1)


def test_the_limit_of_calls_holds_exactly_and_a_resumed_run_goes_on(tmp_path: Path) -> None:
    # Each try is a call: the first one fails, the second is repaired.
    sender = Scripted(fails=lambda number: None if number else TryFailedError(500, "no", retried=True))
    limited, run = Options(concurrency=1, max_calls=6), {"seeds": (14, 16)}
    first = fly(sender, tmp_path / "run", limited, **run)
    assert (first.result.verdict, sender.requests) == ("incomplete", 6)
    assert [flight.status for flight in first.result.flights] == ["finished", "budget_stop"]
    assert first.turns == ["repaired", "ok", "ok", "ok", "budget_stop"]
    assert len(verified_run(tmp_path / "run").results) == 2
    none_left = fly(sender, tmp_path / "run", limited, **run)
    assert (none_left.result.verdict, sender.requests) == ("incomplete", 6)
    done = fly(sender, tmp_path / "run", **run)
    assert (done.result.verdict, sender.requests) == ("valid", len(done.calls) + 1)
    assert len({call.key for call in done.calls}) == len(done.calls)
    budget = Budget(Options())
    budget.resume(verified_run(tmp_path / "run").calls)
    assert budget.requests == sender.requests


def test_a_flight_that_the_limit_did_not_let_begin_is_none(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    # The first of two flights takes 4 calls.
    done = fly(Scripted(), tmp_path / "run", Options(concurrency=1, max_calls=4), seeds=(14, 16)).result
    assert (done.verdict, done.reason) == ("incomplete", "0 flights were cut short and 1 not begun")
    assert len(blocks(capfd.readouterr().out)) == 1
    # A bad answer has begun it: without this flight the run would be no whole one.
    done = fly(Scripted(), tmp_path / "begun", Options(concurrency=1, max_calls=1), seeds=(14, 16)).result
    assert [flight.status for flight in done.flights] == ["budget_stop"]
    assert len(verified_run(tmp_path / "begun").results) == 1


@pytest.mark.parametrize(
    ("limit", "requests"),
    [
        # Each answer takes 102 tokens and costs 1,100 millionths of a dollar.
        *(({"max_tokens": most}, requests) for most, requests in ((204, 2), (205, 3))),
        *(({"max_cost": most}, requests) for most, requests in ((0.0022, 2), (0.0023, 3))),
    ],
)
def test_limits_of_tokens_and_money(tmp_path: Path, limit: Any, requests: int) -> None:
    sender = Scripted("WAIT")
    for _ in range(2):
        fly(sender, tmp_path / "run", Options(concurrency=1, price_prompt=10, price_completion=50, **limit))
        assert sender.requests == requests


def test_what_an_endpoint_does_not_meter_cannot_be_limited(tmp_path: Path) -> None:
    class Unmetered(Scripted):
        async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
            return Answer(text="WAIT")

    flown = fly(Unmetered(), tmp_path / "run", Options(max_tokens=10**6))
    assert flown.turns == ["ok", "budget_stop"]
    assert "does not report its tokens" in str(flown.result.flights[0].error)


@pytest.mark.parametrize(
    "wrong",
    [
        *({f"max_{name}": 0} for name in ("calls", "tokens", "cost")),
        *({"max_cost": 1}, {"requests_per_minute": math.nan}, {"tries": 0}, {"backoff": -1}, {"concurrency": 10_001}),
        {"price_prompt": 1, "price_completion": -1},
    ],
)
def test_what_is_no_limit_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidValueError):
        Options(**wrong)


def test_waits_are_random_below_a_bound_that_doubles(tmp_path: Path) -> None:
    random.seed(1)
    sender = Scripted(fails=lambda number: TryFailedError(500, "no", retried=True) if 0 < number <= 20 else None)
    flown = fly(sender, tmp_path / "run", Options(concurrency=1, tries=21, backoff=0.5))
    assert flown.result.verdict == "valid"
    shares = [wait / min(0.5 * 2**i, MAX_BACKOFF) for i, wait in enumerate(flown.waits)]
    # Spread over what they are drawn from, near none of its ends.
    assert len(shares) == 20
    assert 0 <= min(shares) < 0.25
    assert 0.75 < max(shares) <= 1


@pytest.mark.parametrize(("asked", "requests"), [(0, 3), (MAX_WAIT + 1, 1)])
def test_when_a_failing_call_is_given_up(tmp_path: Path, asked: float, requests: int) -> None:
    sender = Scripted(fails=lambda _: TryFailedError(429, "no", retried=True, retry_after=asked))
    flown = fly(sender, tmp_path / "run", Options(concurrency=1, tries=3))
    assert (sender.requests, flown.seconds, flown.result.verdict) == (requests, 0, "invalid")
    assert [failure.status for failure in flown.calls[0].failures] == [429] * requests
