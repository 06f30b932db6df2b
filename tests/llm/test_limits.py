"""What a run may spend: calls, tokens, money."""

from collections.abc import Callable

import pytest

from drone_env.errors import InvalidValueError
from drone_env.llm.options import Options, Prices
from drone_env.llm.verify import verified_run

from .conftest import Endpoint
from .log_lines import blocks, verified

Start = Callable[..., Endpoint]


def test_the_limit_of_calls_holds_exactly_and_resume_goes_on(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy")
    first = scripted.infer("--seeds", "14:16", "--max-calls", "4", "--concurrency", "1")
    assert first.status == 3
    assert len(scripted.requests()) == 4
    assert [f["status"] for f in first.flights] == ["finished", "budget_stop"]
    assert first.turns == {"ok": 4, "budget_stop": 1}
    verified(first)
    none_left = scripted.infer("--seeds", "14:16", "--max-calls", "4", "--resume", folder=first.folder)
    assert (none_left.status, len(scripted.requests())) == (3, 4)
    second = scripted.infer("--seeds", "14:16", "--resume", folder=first.folder)
    assert second.status == 0, second.err
    calls = [request["call"] for request in scripted.requests()]
    assert len(calls) == len(set(calls)) == second.turns["ok"]
    assert len(blocks(second.out)) == 2
    verified(second)


def test_each_try_is_a_call(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 2, {"status": 500}]])
    done = scripted.infer("--seeds", "14:15", "--max-calls", "4")
    assert (done.status, len(scripted.requests())) == (3, 4)
    assert done.turns == {"ok": 2, "budget_stop": 1}
    assert [call["outcome"] for call in done.calls] == ["ok", "ok"]
    # In the next part of the run as well.
    again = scripted.infer("--seeds", "14:15", "--max-calls", "4", "--resume", folder=done.folder)
    assert (again.status, len(scripted.requests())) == (3, 4)


def test_a_flight_that_the_limit_did_not_let_begin_is_none(endpoint: Start) -> None:
    # Map 14 takes 3 calls.
    done = endpoint(pilot="greedy").infer("--seeds", "14:16", "--max-calls", "3", "--concurrency", "1")
    assert (done.status, [flight["seed"] for flight in done.flights]) == (3, [14])
    assert "0 flights were cut short and 1 not begun" in done.err
    assert len(blocks(done.out)) == 1
    # A bad answer has begun it: without this flight the run would be no whole one.
    done = endpoint(pilot="nonsense").infer("--seeds", "14:16", "--max-calls", "1", "--concurrency", "1")
    assert (done.status, [flight["status"] for flight in done.flights]) == (3, ["budget_stop"])
    assert len(verified_run(done.folder).results) == 1


@pytest.mark.parametrize(
    ("limit", "calls"),
    [
        # Each answer takes 102 tokens and costs 1,100 millionths of a dollar.
        (("--max-tokens", "203"), 2),
        (("--max-tokens", "204"), 2),
        (("--max-tokens", "205"), 3),
        (("--max-cost", "0.0021"), 2),
        (("--max-cost", "0.0022"), 2),
        (("--max-cost", "0.0023"), 3),
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


@pytest.mark.parametrize("name", ["calls", "tokens", "seconds", "cost"])
def test_what_is_no_limit_is_refused(name: str) -> None:
    with pytest.raises(InvalidValueError, match=f"--max-{name} must be above 0, got 0"):
        Options(**{f"max_{name}": 0})
    with pytest.raises(InvalidValueError, match="--max-cost needs prices"):
        Options(max_cost=1)
    with pytest.raises(InvalidValueError, match="prices must be 0 or more"):
        Prices(1, -1)
    for wrong in (0, float("nan"), float("inf")):
        with pytest.raises(InvalidValueError, match="per-minute must be above 0"):
            Options(requests_per_minute=wrong)
