"""How many requests go out at once, per minute and in all, and when failed ones are repeated."""

import asyncio
import math
import random
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.answers import Answer
from drone_env.llm.budget import Budget, Options
from drone_env.llm.endpoint import TryFailedError
from drone_env.llm.limiter import RateLimiter, now
from drone_env.llm.runner import MAX_BACKOFF, MAX_WAIT
from drone_env.llm.verify import verified_run

from .conftest import blocks
from .stored_run import BEGAN, Scripted, fly, in_virtual_time

ELSEWHERE = {"base_url": "https://api.example.com/v1"}


class Server(Scripted):
    """Answers as a greedy pilot. It does not notice that a client is gone, and works on.

    Args:
        batch: Number of requests that it answers at once; others wait.
        seconds: Time for an answer of 100 tokens.
        varying: Whether answers have 20 to 500 tokens.
        loading: Seconds that the first answer takes longer.
        refuses_above: Number of requests at once, above which it refuses.
        fails: Share of requests that fail for no reason.

    Attributes:
        answers: Their number.
        most_open: The most requests that it had at once.
        most_of_a_call: The most requests of one call that it had at once.
        open_seconds: The seconds that clients waited for answers, of all together.
        worked: The seconds that all answers took alone.
    """

    def __init__(
        self,
        batch: int,
        seconds: float = 1.0,
        *,
        varying: bool = False,
        loading: float = 0.0,
        refuses_above: int = 10**9,
        fails: float = 0.0,
    ) -> None:
        super().__init__()
        self._seconds, self._varying, self._loading = seconds, varying, loading
        self._refuses_above, self._share = refuses_above, fails
        self._random = random.Random(1)
        self._places = asyncio.Semaphore(batch)
        self._open: Counter[str] = Counter()
        self.answers = self.most_open = self.most_of_a_call = 0
        self.open_seconds = self.worked = 0.0

    async def _work(self, call_id: str, tokens: int) -> None:
        async with self._places:
            loading, self._loading = self._loading, 0.0
            await asyncio.sleep(loading + self._seconds * tokens / 100)
        self._open[call_id] -= 1

    async def tokens(self, call_id: str) -> int:
        """Work on a request; the tokens of its answer."""
        if self._open.total() >= self._refuses_above:
            raise TryFailedError(429, "too many", retried=True)
        if self._random.random() < self._share:
            raise TryFailedError(500, "bad luck", retried=True)
        tokens = self._random.choice([20, 50, 100, 100, 500]) if self._varying else 100
        self._open[call_id] += 1
        self.most_open = max(self.most_open, self._open.total())
        self.most_of_a_call = max(self.most_of_a_call, self._open[call_id])
        began = now()
        try:
            await asyncio.wait_for(asyncio.shield(asyncio.ensure_future(self._work(call_id, tokens))), 120)
        except asyncio.TimeoutError:
            raise TryFailedError(0, "no answer", retried=True, timed_out=True) from None
        finally:
            self.open_seconds += now() - began
        self.answers += 1
        self.worked += self._seconds * tokens / 100
        return tokens

    async def send(self, request: Mapping[str, Any], call_id: str) -> Answer:
        tokens = await self.tokens(call_id)
        return (await super().send(request, call_id)).model_copy(update={"completion_tokens": tokens})


def with_limiter(
    work: Callable[[RateLimiter], Awaitable[Any]], first: int = 8, most: int = 64, longest: int = 1, **options: Any
) -> tuple[Any, float]:
    """The result of a function that gets a limiter, and the virtual seconds that it took."""

    async def run() -> Any:
        return await work(RateLimiter(Budget(Options(**options)), first, most, longest))

    return in_virtual_time(run())


async def answered(limiter: RateLimiter, flight: int = 0, turn: int = 1) -> float:
    """Send a request that is answered at once; the seconds until it was sent."""
    async with limiter.slot(flight, turn) as sent:
        limiter.answered(sent, Answer(text="UP"))
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


async def answers_of(limiter: RateLimiter, server: Server, flights: int = 100, calls: int = 10) -> None:
    """Fly flights that repeat what fails."""

    async def fly_one(number: int) -> None:
        left = calls
        while left:
            async with limiter.slot(number) as sent:
                server.requests += 1
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

    await asyncio.gather(*map(fly_one, range(flights)))


@pytest.mark.parametrize(
    ("first", "server", "most", "throughput", "most_open"),
    [
        (1, {"batch": 1}, 64, 0.95, 1.2),
        (1, {"batch": 1, "loading": 90}, 64, 0.9, 1.2),
        (8, {"batch": 1}, 64, 0.95, 2.5),
        (1, {"batch": 4}, 64, 3.5, 6),
        (8, {"batch": 16}, 64, 13, 20),
        (8, {"batch": 10**6}, 64, 28, 64),
        (8, {"batch": 10**6}, 3, 2.5, 3),
        (8, {"batch": 10**6, "fails": 0.01}, 64, 24, 64),
        (8, {"batch": 10**6, "refuses_above": 40}, 64, 20, 40),
    ],
    ids=str,
)
def test_a_server_gets_as_many_requests_at_once_as_it_can_use(
    first: int, server: Any, most: int, throughput: float, most_open: float
) -> None:
    # Its answers take 0.2 to 5 s.
    simulated = Server(**server, varying=True)
    _, seconds = with_limiter(lambda limiter: answers_of(limiter, simulated), first, most)
    assert simulated.worked / seconds >= throughput
    assert simulated.open_seconds / seconds <= most_open
    assert simulated.most_open <= most
    assert simulated.requests <= 1.1 * simulated.answers


def test_a_request_that_timed_out_keeps_its_slot_while_its_server_may_work_on_it(tmp_path: Path) -> None:
    # The model is loaded 30 s after the first request was given up.
    server = Server(1, loading=150)
    assert fly(server, tmp_path / "loading", Options()).result.verdict == "valid"
    assert (server.answers, server.most_of_a_call) == (4, 1)
    # No answer ever comes in time.
    server = Server(1, seconds=130)
    assert fly(server, tmp_path / "slow", Options(), seeds=(14, 16)).result.verdict == "invalid"
    assert (server.most_open, server.most_of_a_call) == (1, 1)


def test_an_overload_halves_and_other_failures_only_if_they_are_many() -> None:
    async def work(limiter: RateLimiter) -> None:
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

    with_limiter(work, first=16)


def test_an_overloaded_endpoint_gets_the_longest_pause_that_it_asked_for() -> None:
    async def work(limiter: RateLimiter) -> float:
        async with limiter.slot() as first, limiter.slot() as second:
            limiter.failed(first, 7, overload=True)
            limiter.failed(second, 2, overload=True)
        return await answered(limiter)

    assert with_limiter(work)[0] == 7


def test_waiting_requests_go_by_flight_and_a_cancelled_one_leaves_its_place() -> None:
    async def work(limiter: RateLimiter) -> None:
        order: list[int] = []

        async def one(flight: int) -> None:
            async with limiter.slot(flight):
                order.append(flight)

        # One is cancelled while it waits, and one when it is let in, before it begins.
        for flights, cancelled, late in (((3, 1, 2, 0, 1), 2, False), ((4, 5), 0, True)):
            async with limiter.slot(9):
                waiting = [asyncio.ensure_future(one(flight)) for flight in flights]
                await asyncio.sleep(1)
                if not late:
                    waiting[cancelled].cancel()
            waiting[cancelled].cancel()
            await asyncio.wait(waiting)
        assert (order, limiter.active) == ([0, 1, 1, 3, 5], 0)

    with_limiter(work, most=1)


@pytest.mark.parametrize("concurrency", [1, 64])
@pytest.mark.parametrize("limit", [{"max_calls": 200}, {"max_tokens": 40_000}, {"max_cost": 0.02}], ids=str)
def test_a_budget_ends_as_many_flights_as_it_can(tmp_path: Path, concurrency: int, limit: Any) -> None:
    # A call takes 200 tokens, 100 millionths of a dollar. Of hard, a greedy pilot takes about 40.
    options = Options(concurrency=concurrency, price_prompt=0.5, price_completion=0.5, **limit)
    flown = fly(Server(10**6), tmp_path / "run", options, task="hard", seeds=range(20), **ELSEWHERE).result
    assert [flight.status for flight in flown.flights] == ["finished"] * 4 + ["budget_stop"]


def test_a_rejected_request_is_no_progress_of_its_flight() -> None:
    async def work(limiter: RateLimiter) -> None:
        for _ in range(2):
            await answered(limiter)
        waiting = asyncio.ensure_future(answered(limiter, 1))
        await asyncio.sleep(1)
        # Five turns at two requests each are left of the first flight, but only eight requests.
        assert not waiting.done()
        limiter.ended(0)
        await waiting

    with_limiter(work, longest=5, max_calls=10)


def test_a_budget_that_suffices_for_all_holds_no_flight_back(tmp_path: Path) -> None:
    most_open: list[int] = []
    for name, options in (("free", Options()), ("limited", Options(max_calls=60 * 20))):
        server = Server(10**6)
        assert fly(server, tmp_path / name, options, seeds=range(20), **ELSEWHERE).result.verdict == "valid"
        most_open.append(server.most_open)
    assert most_open[0] == most_open[1] > 16


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
    assert verified_run(tmp_path / "run").requests == sender.requests


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
