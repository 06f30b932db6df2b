"""How many requests go out at once, per minute and in all, and when failed ones are repeated."""

import asyncio
import math
import random
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.limiter import LimitReachedError, RateLimiter
from drone_env.llm.options import Options, Prices
from drone_env.llm.runner import LONGEST_BACKOFF
from drone_env.llm.verify import verified_run

from .conftest import Endpoint
from .kept_run import VirtualClock, fly
from .log_lines import blocks, verified

Start = Callable[..., Endpoint]


def with_limiter(work: Callable[[RateLimiter, VirtualClock], Awaitable[Any]], **options: Any) -> Any:
    async def run() -> Any:
        clock = VirtualClock()
        return await work(RateLimiter(Options(**options), clock), clock)

    return asyncio.run(run())


async def send(limiter: RateLimiter, tokens: int | None = 0, pause: float | None = None) -> None:
    """Send one request; with a pause the endpoint is overloaded."""
    async with limiter.slot() as slot:
        slot.tokens, slot.overloaded, slot.pause = tokens, pause is not None, pause or 0


@pytest.mark.parametrize(
    ("options", "idle", "expected"),
    [
        ({}, 0, [0, 0, 0, 0, 0]),
        # 20 requests a second; one gap may be made up for, however long nothing was sent.
        ({"requests_per_minute": 1200}, 0, [0, 0, 0.05, 0.1, 0.15]),
        ({"requests_per_minute": 1200}, 9, [0, 0, 0.05, 0.1, 9.1]),
        # 50 tokens each, at 1,000 a second.
        ({"tokens_per_minute": 60_000}, 0, [0, 0.05, 0.1, 0.15, 0.2]),
        ({"requests_per_minute": 60, "tokens_per_minute": 60_000}, 0, [0, 0.05, 1, 2, 3]),
    ],
)
def test_requests_and_tokens_per_minute(options: dict[str, float], idle: float, expected: list[float]) -> None:
    async def work(limiter: RateLimiter, clock: VirtualClock) -> list[float]:
        sent: list[float] = []
        for number in range(5):
            clock.time += idle if number == 4 else 0
            await send(limiter, 50)
            sent.append(clock.passed)
        return sent

    assert with_limiter(work, **options) == pytest.approx(expected)


def test_a_request_without_an_answer_takes_no_tokens() -> None:
    async def work(limiter: RateLimiter, clock: VirtualClock) -> None:
        await send(limiter, 100)
        await send(limiter, None)
        assert clock.passed == pytest.approx(0.1)
        async with limiter.slot() as slot:
            assert clock.passed == pytest.approx(0.1)
            # It counts as the mean until its answer is there.
            await send(limiter)
            assert clock.passed == pytest.approx(0.2)
            slot.tokens = 100

    with_limiter(work, tokens_per_minute=60_000)


def test_a_run_keeps_the_pace(endpoint: Start) -> None:
    scripted = endpoint(pilot="WAIT")
    flown = fly(scripted.url, scripted.folder / "run", Options(requests_per_minute=60))
    # The second goes with the first.
    assert (flown.turns, flown.clock.passed) == (["ok"] * 60, pytest.approx(58))
    # Three answers of a second's worth of tokens each, and a failed request that leaves its tokens to the next.
    scripted = endpoint(pilot="greedy", faults=[[1, 1, {"status": 500}]])
    flown = fly(scripted.url, scripted.folder / "tokens", Options(tokens_per_minute=6120, backoff=0))
    assert (flown.turns, flown.clock.passed) == (["ok"] * 3, pytest.approx(2))


def test_concurrency_grows_with_answers_and_halves_under_load() -> None:
    async def work(limiter: RateLimiter, clock: VirtualClock) -> None:
        async def answered(n: int) -> None:
            for _ in range(n):
                await send(limiter)

        async def overloaded() -> None:
            clock.time += 1
            await send(limiter, pause=0)

        assert limiter.limit == 8
        await answered(8)
        assert limiter.limit == 16
        async with limiter.slot() as slot:
            await overloaded()
            assert limiter.limit == 8
            slot.overloaded = True  # sent before the last halving
        assert limiter.limit == 8
        # From now on one more after a round of answers.
        await answered(8)
        assert 8.9 < limiter.limit < 9
        for _ in range(10):
            await overloaded()
        assert limiter.limit == 1
        await answered(10_000)
        assert limiter.limit == 100

    with_limiter(work, concurrency=100)


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

    with_limiter(work, concurrency=3)


def test_an_overloaded_endpoint_gets_a_pause_within_the_time_of_the_run() -> None:
    async def work(limiter: RateLimiter, clock: VirtualClock) -> None:
        async with limiter.slot() as slot:
            slot.overloaded, slot.pause = True, 7
            await send(limiter, pause=2)  # the longer pause holds
        await send(limiter)
        assert clock.slept == [7]
        await send(limiter, pause=60)
        with pytest.raises(LimitReachedError, match="10 s have passed"):
            await send(limiter)
        assert (clock.slept, limiter.active) == ([7, 3], 0)

    with_limiter(work, max_seconds=10)


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
        assert (second.cancelled(), limiter.active) == (True, 1)
        third.cancel()
        await asyncio.gather(third, return_exceptions=True)
        assert limiter.active == 0

    with_limiter(work, concurrency=1)


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
        *((("--max-tokens", most), calls) for most, calls in (("203", 2), ("204", 2), ("205", 3))),
        *((("--max-cost", most), calls) for most, calls in (("0.0021", 2), ("0.0022", 2), ("0.0023", 3))),
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
    assert "does not say how many tokens it used" in done.err


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        *(({f"max_{name}": 0}, f"--max-{name} must be above 0") for name in ("calls", "tokens", "seconds", "cost")),
        ({"max_cost": 1}, "--max-cost needs prices"),
        ({"requests_per_minute": 0}, "per-minute must be above 0"),
        ({"tokens_per_minute": math.nan}, "per-minute must be above 0"),
        *(({name: value}, "tries must be 1 to 100") for name, value in (("tries", 0), ("tries", 101), ("backoff", -1))),
        ({"longest_wait": math.nan}, "tries must be 1 to 100"),
    ],
)
def test_what_is_no_limit_is_refused(wrong: dict[str, Any], why: str) -> None:
    with pytest.raises(InvalidValueError, match=why):
        Options(**wrong)
    with pytest.raises(InvalidValueError, match="prices must be 0 or more"):
        Prices(1, -1)


def test_waits_are_random_below_a_bound_that_doubles(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 20, {"status": 500}]])
    random.seed(1)
    flown = fly(scripted.url, scripted.folder / "run", Options(tries=21, backoff=0.5))
    waits = flown.clock.slept
    assert flown.turns == ["ok"] * 3
    assert len(waits) == 20
    bounds = [min(0.5 * 2**i, LONGEST_BACKOFF) for i in range(20)]
    assert all(0 <= wait <= bound for wait, bound in zip(waits, bounds, strict=True))
    # Spread over what they are drawn from, near none of its ends.
    shares = [wait / bound for wait, bound in zip(waits, bounds, strict=True)]
    assert (min(shares) < 0.25, max(shares) > 0.75) == (True, True)
    assert [failure.waited for failure in flown.calls[1].failures] == waits


def test_what_the_endpoint_asks_for_is_waited(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 1, {"status": 429, "headers": {"Retry-After": "120"}}]])
    flown = fly(scripted.url, scripted.folder / "run", Options())
    assert (flown.turns, flown.clock.slept) == (["ok"] * 3, [120.0])


@pytest.mark.parametrize(
    ("asked", "options", "requests", "slept", "verdict"),
    [
        ("0", {"tries": 3}, 3, [0, 0], "invalid"),
        ("121", {"longest_wait": 120}, 1, [], "invalid"),
        # No wait is longer than the time of the run.
        ("100", {"max_seconds": 30}, 1, [30], "incomplete"),
    ],
)
def test_when_a_failing_call_is_given_up(
    endpoint: Start, asked: str, options: dict[str, Any], requests: int, slept: list[float], verdict: str
) -> None:
    fault = {"status": 429, "headers": {"Retry-After": asked}}
    scripted = endpoint(pilot="greedy", faults=[[0, 10**9, fault]])
    flown = fly(scripted.url, scripted.folder / "run", Options(**options))
    assert (len(scripted.requests()), flown.clock.slept, flown.result.verdict) == (requests, slept, verdict)
    assert [failure.status for failure in flown.calls[0].failures] == [429] * requests


def test_behind_the_time_of_the_run_nothing_is_sent(endpoint: Start) -> None:
    scripted = endpoint(pilot="WAIT")
    flown = fly(scripted.url, scripted.folder / "run", Options(max_seconds=30, requests_per_minute=6))
    # Two together, then one each 10 s, and none at the end of the 30th.
    assert (flown.turns, flown.clock.passed) == (["ok"] * 4 + ["budget_stop"], 30)
    assert len(scripted.requests()) == 4
    assert flown.result.flights[0].error == "30 s have passed"
