"""Endpoints that refuse, break off or start: what is tried again, and what becomes of flight and run."""

import json
from pathlib import Path

import pytest

from drone_env.llm.sender import TryFailedError
from tests.tools import reserved_port

from .conftest import TOKEN, Start, blocks, verified
from .stored_run import Scripted, fly

ALWAYS = 10**9


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ({"status": 401, "message": f"Incorrect API key provided: {TOKEN}"}, "returned 401: the token is missing"),
        ({"status": 400, "message": "no temperature"}, "returned 400: no temperature\n"),
    ],
)
def test_what_the_first_call_is_refused_for_stops_the_run(endpoint: Start, fault: object, told: str) -> None:
    scripted = endpoint(pilot="greedy", faults=[[0, ALWAYS, fault]])
    done = scripted.infer("--episodes", "9", "--concurrency", "1")
    assert (done.status, told in done.err, len(scripted.requests())) == (2, True, 1), done.err
    assert [flight.status for flight in done.flights] == ["errored"]
    (lines,) = blocks(done.out)
    assert lines[-1] == "[END] success=false steps=0 score=null rewards="
    # The same options could be rejected again.
    assert done.err.endswith("nothing was answered: begin a new run, with other options if these are rejected\n")
    verified(done)


def test_a_run_without_credit_stops_at_once_and_goes_on_later(endpoint: Start) -> None:
    error = {"error": {"message": "see your plan", "type": "insufficient_quota"}}
    faults = [[5, 5, "hang"], [7, 7, {"status": 429, "sends": json.dumps(error)}]]
    scripted = endpoint(pilot="greedy", faults=faults)
    run = ("--seeds", "14:17", "--concurrency", "3")
    # Another flight is under way, so there is no report yet.
    stopped = scripted.infer(*run, "--report")
    assert (stopped.status, len([c for c in stopped.calls if c["failures"]])) == (2, 1)
    assert "429: the account has no credit left: add credit, then continue the run (see your plan)" in stopped.err
    assert f"to continue, give the same options with --out {stopped.folder} --resume\n" in stopped.err
    done = scripted.infer(*run, "--resume", folder=stopped.folder)
    assert (done.status, [flight.status for flight in done.flights]) == (0, ["finished"] * 3), done.err
    verified(done)


@pytest.mark.parametrize("fault", ["cut", "cut_body", "hang", {"status": 429, "headers": {"Retry-After": "0.1"}}])
def test_what_passes_is_told_and_tried_again(endpoint: Start, fault: object) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 1, fault]])
    done = scripted.infer("--seeds", "14:15", "--timeout", "1" if fault == "hang" else "60")
    assert (done.status, done.turns, done.flights[0].score) == (0, {"ok": 3}, 0.99), done.err
    assert [request["call"] for request in scripted.requests()] == ["0-1-1", "0-2-1", "0-2-1", "0-3-1"]
    assert "map 14, turn 2: attempt 1 of 8 failed: " in done.err
    assert [len(call["failures"]) for call in done.calls] == [0, 1, 0]
    if isinstance(fault, dict):
        assert "failed: 429: scripted 429; next attempt in 0.1 s\n" in done.err
        assert done.calls[1]["failures"] == [{"status": 429, "reason": "scripted 429", "waited": 0.1}]


def test_an_address_without_a_server_stops_the_run_after_the_last_try(endpoint: Start) -> None:
    address = f"127.0.0.1:{reserved_port()}"
    done = endpoint().infer(
        "--base-url", f"http://{address}/v1", "--episodes", "9", "--tries", "2", "--concurrency", "1"
    )
    assert (done.status, len(done.flights)) == (2, 1)
    assert done.err.count("attempt 1 of 2 failed: no answer: ") == 1
    assert f"stopped: {address} gives no answer: {address} takes no connection (" in done.err


@pytest.mark.parametrize(("status", "verdict"), [(0, "stopped"), (500, "invalid")])
def test_a_server_that_goes_away_stops_the_run_and_a_failing_call_its_flight(
    tmp_path: Path, status: int, verdict: str
) -> None:
    failed = TryFailedError(status, "gone", retried=True, fatal=not status)
    flown = fly(Scripted(fails=lambda number: failed if number > 4 else None), tmp_path / "run", seeds=(14, 17))
    assert flown.result.verdict[0] == verdict
    assert [flight.status for flight in flown.result.flights] == ["finished", *["errored"] * (2 if status else 1)]
