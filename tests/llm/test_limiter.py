"""How many requests go out at once, per minute and in all, and when failed ones are repeated."""

import asyncio
import math
import random
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.limiter import Options, RateLimiter
from drone_env.llm.runner import MAX_BACKOFF, MAX_WAIT
from drone_env.llm.verify import verified_run

from .conftest import Start, blocks, verified
from .stored_run import VirtualClock, fly


def with_limiter(work: Callable[[RateLimiter, VirtualClock], Awaitable[Any]], **options: Any) -> Any:
    async def run() -> Any:
        clock = VirtualClock()
        return await work(RateLimiter(Options(**options), clock.now, clock.sleep), clock)

    return asyncio.run(run())


async def answered(limiter: RateLimiter, n: int = 1) -> None:
    """Send requests that are answered."""
    for _ in range(n):
        async with limiter.slot():
            limiter.answered()


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
    async def work(limiter: RateLimiter, clock: VirtualClock) -> list[float]:
        sent: list[float] = []
        for number in range(5):
            clock.time += idle if number == 4 else 0
            await answered(limiter)
            sent.append(clock.passed)
        return sent

    assert with_limiter(work, **options) == pytest.approx(expected)


def test_concurrency_grows_with_answers_and_halves_under_load() -> None:
    async def work(limiter: RateLimiter, clock: VirtualClock) -> None:
        async def overloaded() -> None:
            clock.time += 1
            async with limiter.slot() as sent_at:
                limiter.overloaded(sent_at, 0)

        assert limiter.limit == 8
        await answered(limiter, 8)
        assert limiter.limit == 16
        async with limiter.slot() as sent_at:
            await overloaded()
            assert limiter.limit == 8
            limiter.overloaded(sent_at, 0)  # sent before the last halving
        assert limiter.limit == 8
        # From now on one more after a round of answers.
        await answered(limiter, 8)
        assert 8.9 < limiter.limit < 9
        for _ in range(10):
            await overloaded()
        assert limiter.limit == 1
        await answered(limiter, 10_000)
        assert limiter.limit == 100

    with_limiter(work, concurrency=100)


def test_the_limiter_bounds_the_requests_at_once() -> None:
    async def work(limiter: RateLimiter, clock: VirtualClock) -> None:
        seen: list[int] = []

        async def one() -> None:
            async with limiter.slot():
                seen.append(limiter.active)
                await asyncio.sleep(0)

        await asyncio.gather(*(one() for _ in range(50)))
        assert (max(seen), len(seen), limiter.active) == (3, 50, 0)

    with_limiter(work, concurrency=3)


def test_an_overloaded_endpoint_gets_the_longest_pause_that_it_asked_for() -> None:
    async def work(limiter: RateLimiter, clock: VirtualClock) -> None:
        async with limiter.slot() as first, limiter.slot() as second:
            limiter.overloaded(first, 7)
            limiter.overloaded(second, 2)
        await answered(limiter)
        assert clock.slept == [7]

    with_limiter(work)


def test_the_limit_of_calls_holds_exactly_and_resume_goes_on(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[0, 0, {"status": 500}]])
    # Each try is a call.
    first = scripted.infer("--seeds", "14:16", "--max-calls", "5", "--concurrency", "1")
    assert (first.status, len(scripted.requests())) == (3, 5)
    assert [f["status"] for f in first.flights] == ["finished", "budget_stop"]
    assert first.turns == {"ok": 4, "budget_stop": 1}
    verified(first)
    none_left = scripted.infer("--seeds", "14:16", "--max-calls", "5", "--resume", folder=first.folder)
    assert (none_left.status, len(scripted.requests())) == (3, 5)
    second = scripted.infer("--seeds", "14:16", "--resume", folder=first.folder)
    assert second.status == 0, second.err
    calls = [request["call"] for request in scripted.requests()]
    assert len(calls) - 1 == len(set(calls)) == second.turns["ok"]
    assert len(blocks(second.out)) == 2
    verified(second)


def test_a_flight_that_the_limit_did_not_let_begin_is_none(endpoint: Start) -> None:
    # Map 14 takes 3 calls.
    done = endpoint(pilot="greedy").infer("--seeds", "14:16", "--max-calls", "3", "--concurrency", "1")
    assert (done.status, [flight["seed"] for flight in done.flights]) == (3, [14])
    assert "0 flights were cut short and 1 not begun" in done.err
    # A bad answer has begun it: without this flight the run would be no whole one.
    done = endpoint(pilot="nonsense").infer("--seeds", "14:16", "--max-calls", "1", "--concurrency", "1")
    assert (done.status, [flight["status"] for flight in done.flights]) == (3, ["budget_stop"])
    assert len(verified_run(done.folder).results) == 1


# Each answer takes 102 tokens and costs 1,100 millionths of a dollar.
@pytest.mark.parametrize(
    ("limit", "calls"),
    [
        *((("--max-tokens", most), calls) for most, calls in (("204", 2), ("205", 3))),
        *((("--max-cost", most), calls) for most, calls in (("0.0022", 2), ("0.0023", 3))),
    ],
)
def test_limits_of_tokens_and_money(endpoint: Start, limit: tuple[str, str], calls: int) -> None:
    scripted = endpoint(pilot="WAIT")
    arguments = ("--seeds", "14:15", "--price-prompt", "10", "--price-completion", "50", *limit)
    done = scripted.infer(*arguments)
    assert (done.status, done.turns) == (3, {"ok": calls, "budget_stop": 1})
    again = scripted.infer(*arguments, "--resume", folder=done.folder)
    assert (again.status, len(scripted.requests())) == (3, calls)


def test_what_an_endpoint_does_not_meter_cannot_be_limited(endpoint: Start) -> None:
    done = endpoint(pilot="greedy", no_usage=True).infer("--seeds", "14:15", "--max-tokens", "100000")
    assert (done.status, done.turns) == (3, {"ok": 1, "budget_stop": 1})


@pytest.mark.parametrize(
    "wrong",
    [
        *({f"max_{name}": 0} for name in ("calls", "tokens", "cost")),
        *({"max_cost": 1}, {"requests_per_minute": math.nan}, {"tries": 0}, {"backoff": -1}, {"concurrency": 10_001}),
    ],
)
def test_what_is_no_limit_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidValueError):
        Options(**wrong)
    with pytest.raises(InvalidValueError, match="prices must be 0 or more"):
        Options(price_prompt=1, price_completion=-1)


def test_waits_are_random_below_a_bound_that_doubles(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 20, {"status": 500}]])
    random.seed(1)
    flown = fly(scripted.url, scripted.folder / "run", Options(concurrency=1, tries=21, backoff=0.5))
    waits = flown.clock.slept
    assert (flown.turns, len(waits)) == (["ok"] * 3, 20)
    shares = [wait / min(0.5 * 2**i, MAX_BACKOFF) for i, wait in enumerate(waits)]
    # Spread over what they are drawn from, near none of its ends.
    assert 0 <= min(shares) < 0.25
    assert 0.75 < max(shares) <= 1
    assert [failure.waited for failure in flown.calls[1].failures] == waits


@pytest.mark.parametrize(("asked", "requests", "slept"), [("0", 3, [0, 0]), (f"{MAX_WAIT + 1}", 1, [])])
def test_when_a_failing_call_is_given_up(endpoint: Start, asked: str, requests: int, slept: list[float]) -> None:
    fault = {"status": 429, "headers": {"Retry-After": asked}}
    scripted = endpoint(pilot="greedy", faults=[[0, 10**9, fault]])
    flown = fly(scripted.url, scripted.folder / "run", Options(concurrency=1, tries=3))
    assert (len(scripted.requests()), flown.clock.slept, flown.result.verdict) == (requests, slept, "invalid")
    assert [failure.status for failure in flown.calls[0].failures] == [429] * requests
