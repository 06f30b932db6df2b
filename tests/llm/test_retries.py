"""How long is waited between tries, and when no longer: real requests, and a clock that only waiting moves."""

import random
from collections.abc import Callable
from email.utils import formatdate
from time import time

from drone_env.llm.options import Options
from drone_env.llm.runner import LONGEST_BACKOFF

from .conftest import Endpoint
from .kept_run import fly

Start = Callable[..., Endpoint]
ALWAYS = 10**9


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


def test_so_many_tries_and_no_more(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[0, ALWAYS, {"status": 500}]])
    flown = fly(scripted.url, scripted.folder / "run", Options(tries=3))
    assert (flown.turns, len(scripted.requests()), len(flown.clock.slept)) == (["api_error"], 3, 2)
    assert [failure.status for failure in flown.calls[0].failures] == [500] * 3


def test_what_the_endpoint_asks_for_is_waited(endpoint: Start) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 1, {"status": 429, "headers": {"Retry-After": "120"}}]])
    flown = fly(scripted.url, scripted.folder / "run", Options())
    assert (flown.turns, flown.clock.slept) == (["ok"] * 3, [120.0])


def test_a_moment_that_the_endpoint_names_is_waited_for(endpoint: Start) -> None:
    faults = [[1, 1, {"status": 503, "headers": {"Retry-After": formatdate(time() + 3600, usegmt=True)}}]]
    scripted = endpoint(pilot="greedy", faults=faults)
    flown = fly(scripted.url, scripted.folder / "run", Options(longest_wait=3600))
    (waited,) = flown.clock.slept
    assert 3000 < waited <= 3600


def test_a_longer_wait_than_allowed_is_an_api_error(endpoint: Start) -> None:
    faults = [[0, ALWAYS, {"status": 429, "headers": {"Retry-After": "121"}}]]
    scripted = endpoint(pilot="greedy", faults=faults)
    flown = fly(scripted.url, scripted.folder / "run", Options())
    assert (flown.turns, len(scripted.requests()), flown.clock.slept) == (["api_error"], 1, [])
    assert flown.result.verdict == "invalid"


def test_no_wait_is_longer_than_the_time_of_the_run(endpoint: Start) -> None:
    fault = {"status": 429, "headers": {"Retry-After": "100"}}
    scripted = endpoint(pilot="greedy", faults=[[0, ALWAYS, fault]])
    flown = fly(scripted.url, scripted.folder / "run", Options(max_seconds=30), seeds=(14, 17))
    assert flown.clock.slept == [30]
    assert len(scripted.requests()) == 1
    assert flown.result.verdict == "incomplete"


def test_behind_the_time_of_the_run_nothing_is_sent(endpoint: Start) -> None:
    scripted = endpoint(pilot="WAIT")
    flown = fly(scripted.url, scripted.folder / "run", Options(max_seconds=30, requests_per_minute=6))
    # Two together, then one each 10 s, and none at the end of the 30th.
    assert (flown.turns, flown.clock.passed) == (["ok"] * 4 + ["budget_stop"], 30)
    assert len(scripted.requests()) == 4
    assert flown.result.flights[0].error == "30 s have passed"
