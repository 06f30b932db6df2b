"""How many requests go out at once, per minute and in all, and when failed ones are repeated."""

import asyncio
import math
import random
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.answers import Answer
from drone_env.llm.budget import Options
from drone_env.llm.endpoint import TryFailedError
from drone_env.llm.limiter import RateLimiter
from drone_env.llm.runner import MAX_BACKOFF, MAX_WAIT
from drone_env.llm.verify import verified_run

from .conftest import Start, blocks, verified
from .stored_run import fly
from .virtual_time import BEGAN, Server, in_virtual_time, simulate


def with_limiter(work: Callable[[RateLimiter], Awaitable[Any]], **options: Any) -> Any:
    async def run() -> Any:
        return await work(RateLimiter(Options(**options), asyncio.get_running_loop().time))

    return in_virtual_time(run())


async def answered(limiter: RateLimiter, flight: int = 0) -> float:
    """Send a request that is answered at once; the seconds until it was sent."""
    async with limiter.slot(flight) as sent:
        limiter.answered(sent, Answer(text="UP"))
    return limiter.now() - BEGAN


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

    assert with_limiter(work, **options) == pytest.approx(expected)


ELSEWHERE = {"base_url": "https://api.example.com/v1"}


async def answers_of(limiter: RateLimiter, server: Server, flights: int = 100, calls: int = 10) -> None:
    """Fly flights that repeat what fails."""

    async def fly(number: int) -> None:
        left = calls
        while left:
            async with limiter.slot(number) as sent:
                try:
                    tokens = await server.tokens(str(number))
                except TryFailedError as error:
                    limiter.failed(sent, 0, overload=error.status == 429)
                else:
                    left -= 1
                    # Half of them are not metered.
                    metered = Answer(text="UP", completion_tokens=tokens)
                    limiter.answered(sent, metered if left % 2 else Answer(text="UP. " * tokens))
            await asyncio.sleep(0.1)

    await asyncio.gather(*map(fly, range(flights)))


@pytest.mark.parametrize(
    ("first", "server", "throughput", "most_open"),
    [
        (1, {"batch": 1}, 0.95, 1.2),
        (1, {"batch": 1, "loading": 90}, 0.9, 1.2),
        (8, {"batch": 1}, 0.95, 2.5),
        (1, {"batch": 4}, 3.5, 6),
        (8, {"batch": 16}, 13, 20),
        (8, {"batch": 10**6}, 28, 64),
        (8, {"batch": 10**6, "fails": 0.01}, 24, 64),
        (8, {"batch": 10**6, "refuses_above": 40}, 20, 40),
    ],
    ids=str,
)
def test_a_server_gets_as_many_requests_at_once_as_it_can_use(
    first: int, server: Any, throughput: float, most_open: float
) -> None:
    # Its answers take 0.2 to 5 s.
    simulated = Server(**server, varying=True)

    async def work(limiter: RateLimiter) -> float:
        limiter.begin(first, 100, 1)
        await answers_of(limiter, simulated)
        return limiter.now() - BEGAN

    seconds = with_limiter(work)
    assert simulated.worked / seconds >= throughput
    assert simulated.open_seconds / seconds <= most_open
    assert simulated.requests <= 1.1 * simulated.answers


def test_the_limiter_bounds_the_requests_at_once() -> None:
    server = Server(10**6)
    with_limiter(lambda limiter: answers_of(limiter, server), concurrency=3)
    assert (server.most_open, server.answers) == (3, 1000)


def test_a_request_that_timed_out_keeps_its_slot_while_its_server_may_work_on_it(tmp_path: Path) -> None:
    # The model is loaded 30 s after the first request was given up.
    server = Server(1, loading=150)
    assert simulate(server, tmp_path / "loading", seeds=(14, 15)).verdict == "valid"
    assert (server.requests, server.answers, server.most_of_a_call) == (5, 4, 1)
    # No answer ever comes in time.
    server = Server(1, seconds=130)
    assert simulate(server, tmp_path / "slow", seeds=(14, 16)).verdict == "invalid"
    assert (server.most_open, server.most_of_a_call) == (1, 1)


def test_an_overload_halves_and_other_failures_only_if_they_are_many() -> None:
    async def work(limiter: RateLimiter) -> None:
        limiter.begin(16, 64, 1)

        async def failed(overload: bool) -> int:
            await asyncio.sleep(1)
            async with limiter.slot() as sent:
                limiter.failed(sent, 0, overload)
            return limiter.limit

        assert [await failed(overload=False) for _ in range(3)] == [16, 8, 4]
        async with limiter.slot() as sent:
            assert await failed(overload=True) == 2
            limiter.failed(sent, 0, overload=True)  # sent before the last halving
            assert limiter.limit == 2
        assert [await failed(overload=True) for _ in range(2)] == [1, 1]

    with_limiter(work)


def test_an_overloaded_endpoint_gets_the_longest_pause_that_it_asked_for() -> None:
    async def work(limiter: RateLimiter) -> None:
        async with limiter.slot() as first, limiter.slot() as second:
            limiter.failed(first, 7, overload=True)
            limiter.failed(second, 2, overload=True)
        assert await answered(limiter) == 7

    with_limiter(work)


def test_waiting_requests_go_by_flight_and_a_cancelled_one_leaves_its_place() -> None:
    async def work(limiter: RateLimiter) -> None:
        order: list[int] = []

        async def one(flight: int) -> None:
            async with limiter.slot(flight):
                order.append(flight)

        async with limiter.slot(9):
            waiting = [asyncio.ensure_future(one(flight)) for flight in (3, 1, 2, 0, 1)]
            await asyncio.sleep(1)
            waiting[2].cancel()
        await asyncio.wait(waiting)
        assert order == [0, 1, 1, 3]
        # One is let in, and cancelled before it begins.
        async with limiter.slot(9):
            waiting = [asyncio.ensure_future(one(flight)) for flight in (4, 5)]
            await asyncio.sleep(1)
        waiting[0].cancel()
        await asyncio.wait(waiting)
        assert (order[4:], limiter.active) == ([5], 0)

    with_limiter(work, concurrency=1)


@pytest.mark.parametrize("concurrency", [1, 64])
@pytest.mark.parametrize("limit", [{"max_calls": 200}, {"max_tokens": 40_000}, {"max_cost": 0.02}], ids=str)
def test_a_budget_ends_as_many_flights_as_it_can(tmp_path: Path, concurrency: int, limit: Any) -> None:
    # A call takes 200 tokens, 100 millionths of a dollar. Of hard, a greedy pilot takes about 40.
    options = Options(concurrency=concurrency, price_prompt=0.5, price_completion=0.5, **limit)
    flown = simulate(Server(10**6), tmp_path / "run", options, task="hard", seeds=range(20), **ELSEWHERE)
    assert [flight.status for flight in flown.flights] == ["finished"] * 4 + ["budget_stop"]


def test_a_rejected_request_is_no_progress_of_its_flight() -> None:
    async def work(limiter: RateLimiter) -> None:
        limiter.begin(4, flights=2, longest=5)
        for _ in range(2):
            async with limiter.slot(0, turn=1):
                pass

        async def next_flight() -> None:
            async with limiter.slot(1, turn=1):
                pass

        waiting = asyncio.ensure_future(next_flight())
        await asyncio.sleep(1)
        # Five turns at two requests each are left of the first flight, but only eight requests.
        assert not waiting.done()
        limiter.ended(0)
        await waiting

    with_limiter(work, max_calls=10)


def test_a_budget_that_suffices_for_all_holds_no_flight_back(tmp_path: Path) -> None:
    most_open: list[int] = []
    for name, options in (("free", Options()), ("limited", Options(max_calls=60 * 20))):
        server = Server(10**6)
        assert simulate(server, tmp_path / name, options, seeds=range(20), **ELSEWHERE).verdict == "valid"
        most_open.append(server.most_open)
    assert most_open[0] == most_open[1] > 16


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
    with pytest.raises(InvalidValueError, match="must be 0 or more"):
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
