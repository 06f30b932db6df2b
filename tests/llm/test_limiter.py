"""When requests are sent, how many in all, and when failed ones are repeated."""

import asyncio
import math
import random
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.answers import Answer
from drone_env.llm.budget import Budget, Options, now
from drone_env.llm.run_folder import read_run
from drone_env.llm.runner import MAX_BACKOFF, MAX_WAIT
from drone_env.llm.sender import TryFailedError

from .conftest import blocks
from .stored_run import BEGAN, Scripted, fly, in_virtual_time


def with_limiter(work: Callable[[Budget], Awaitable[Any]], **options: Any) -> tuple[Any, float]:
    """The result of a function that gets a limiter, and the virtual seconds that it took."""

    async def run() -> Any:
        return await work(Budget(Options(**options)))

    return in_virtual_time(run())


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
    async def work(limiter: Budget) -> list[float]:
        sent = list[float]()
        for number in range(5):
            await asyncio.sleep(idle if number == 4 else 0)
            await limiter.turn()
            sent.append(now() - BEGAN)
        return sent

    assert with_limiter(work, **options)[0] == pytest.approx(expected)


def test_an_overloaded_endpoint_gets_the_longest_pause_that_it_asked_for() -> None:
    async def work(limiter: Budget) -> None:
        limiter.pause(7)
        limiter.pause(2)
        await limiter.turn()

    assert with_limiter(work)[1] == 7


def test_waiting_requests_go_in_order_and_a_cancelled_one_leaves_its_place() -> None:
    async def work(limiter: Budget) -> list[int]:
        order: list[int] = []

        async def one(number: int) -> None:
            await limiter.turn()
            order.append(number)

        limiter.pause(5)
        waiting = [asyncio.ensure_future(one(number)) for number in range(4)]
        await asyncio.sleep(1)
        waiting[0].cancel()
        waiting[2].cancel()
        await asyncio.wait(waiting)
        return order

    assert with_limiter(work)[0] == [1, 3]


@pytest.mark.parametrize(("status", "second"), [(429, 7), (500, 0)])
def test_a_wait_for_an_overloaded_endpoint_holds_back_all_flights(tmp_path: Path, status: int, second: int) -> None:
    sent = list[float]()

    def fails(number: int) -> TryFailedError | None:
        sent.append(now() - BEGAN)
        return TryFailedError(status, "no", retried=True, retry_after=7) if number == 0 else None

    fly(Scripted(fails=fails), tmp_path / "run", Options(concurrency=2), seeds=(14, 16))
    assert sent[:3] == [0, second, second]


def test_the_limit_of_calls_holds_exactly_and_a_resumed_run_goes_on(tmp_path: Path) -> None:
    # Each try is a call: the first one fails, the second is repaired.
    sender = Scripted(fails=lambda number: None if number else TryFailedError(500, "no", retried=True))
    limited, run = Options(concurrency=1, max_calls=6), {"seeds": (14, 16)}
    first = fly(sender, tmp_path / "run", limited, **run)
    assert (first.result.verdict[0], sender.requests) == ("incomplete", 6)
    assert [flight.status for flight in first.result.flights] == ["finished", "budget_stop"]
    assert first.turns == ["repaired", "ok", "ok", "ok", "budget_stop"]
    assert len(read_run(tmp_path / "run").flights) == 2
    none_left = fly(sender, tmp_path / "run", limited, **run)
    assert (none_left.result.verdict[0], sender.requests) == ("incomplete", 6)
    done = fly(sender, tmp_path / "run", **run)
    assert (done.result.verdict[0], sender.requests) == ("valid", len(done.calls) + 1)
    assert len({call.key for call in done.calls}) == len(done.calls)
    assert read_run(tmp_path / "run").budget.requests == sender.requests


def test_a_flight_that_the_limit_did_not_let_begin_is_none(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    # The first of two flights takes 4 calls.
    done = fly(Scripted(), tmp_path / "run", Options(concurrency=1, max_calls=4), seeds=(14, 16)).result
    assert done.verdict == ("incomplete", "flights cut short: 0; not begun: 1")
    assert len(blocks(capfd.readouterr().out)) == 1
    # A bad answer has begun it: without this flight the run would be no whole one.
    done = fly(Scripted(), tmp_path / "begun", Options(concurrency=1, max_calls=1), seeds=(14, 16)).result
    assert [flight.status for flight in done.flights] == ["budget_stop"]
    assert len(read_run(tmp_path / "begun").flights) == 1


@pytest.mark.parametrize(("most", "requests"), [(204, 2), (205, 3)])
def test_the_limit_of_tokens(tmp_path: Path, most: int, requests: int) -> None:
    # Each answer takes 102 tokens.
    sender = Scripted("WAIT")
    for _ in range(2):
        fly(sender, tmp_path / "run", Options(concurrency=1, max_tokens=most))
        assert sender.requests == requests


def test_what_an_endpoint_does_not_meter_cannot_be_limited(tmp_path: Path) -> None:
    class Unmetered(Scripted):
        async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
            return Answer(text="WAIT")

    flown = fly(Unmetered(), tmp_path / "run", Options(max_tokens=10**6))
    assert flown.turns == ["ok", "budget_stop"]
    assert "does not report its tokens" in str(flown.result.flights[0].error)


@pytest.mark.parametrize("wrong", [{"max_calls": 0}, {"requests_per_minute": math.nan}, {"tries": 0}, {"backoff": -1}])
def test_what_is_no_limit_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InvalidValueError, match="must be above 0"):
        Options(**wrong)


def test_waits_are_random_below_a_bound_that_doubles(tmp_path: Path) -> None:
    random.seed(1)
    sender = Scripted(fails=lambda number: TryFailedError(500, "no", retried=True) if 0 < number <= 20 else None)
    flown = fly(sender, tmp_path / "run", Options(concurrency=1, tries=21, backoff=0.5))
    assert flown.result.verdict == ("valid", "")
    shares = [wait / min(0.5 * 2**i, MAX_BACKOFF) for i, wait in enumerate(flown.waits)]
    # Spread over what they are drawn from, near none of its ends.
    assert len(shares) == 20
    assert 0 <= min(shares) < 0.25
    assert 0.75 < max(shares) <= 1


@pytest.mark.parametrize(("asked", "requests"), [(0, 3), (MAX_WAIT + 1, 1)])
def test_when_a_failing_call_is_given_up(tmp_path: Path, asked: float, requests: int) -> None:
    sender = Scripted(fails=lambda _: TryFailedError(429, "no", retried=True, retry_after=asked))
    flown = fly(sender, tmp_path / "run", Options(concurrency=1, tries=3))
    assert (sender.requests, flown.seconds, flown.result.verdict[0]) == (requests, 0, "stopped")
    assert [failure.status for failure in flown.calls[0].failures] == [429] * requests
