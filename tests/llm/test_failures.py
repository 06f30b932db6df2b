"""Endpoints that refuse, break off or start: what is tried again, and what becomes of flight and run."""

import json
from pathlib import Path

import pytest

from drone_env.llm.budget import Options
from drone_env.llm.endpoint import TryFailedError
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
    assert [f["status"] for f in done.flights] == ["errored"]
    (lines,) = blocks(done.out)
    assert lines[-1] == "[END] success=false steps=0 score=null rewards="
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
    assert (done.status, [flight["status"] for flight in done.flights]) == (0, ["finished"] * 3), done.err
    verified(done)


@pytest.mark.parametrize("fault", ["cut", "cut_body", "hang", {"status": 429, "headers": {"Retry-After": "0.1"}}])
def test_what_passes_is_told_and_tried_again(endpoint: Start, fault: object) -> None:
    scripted = endpoint(pilot="greedy", faults=[[1, 1, fault]])
    done = scripted.infer("--seeds", "14:15", "--timeout", "1" if fault == "hang" else "60")
    assert (done.status, done.turns, done.flights[0]["score"]) == (0, {"ok": 3}, 0.99), done.err
    assert [request["call"] for request in scripted.requests()] == ["0-1-1", "0-2-1", "0-2-1", "0-3-1"]
    assert "map 14, turn 2: attempt 1 of 6 failed: " in done.err
    assert [len(call["failures"]) for call in done.calls] == [0, 1, 0]
    if isinstance(fault, dict):
        assert "failed: 429: scripted 429; next attempt in 0.1 s\n" in done.err
        assert done.calls[1]["failures"] == [{"status": 429, "reason": "scripted 429", "waited": 0.1}]


@pytest.mark.parametrize(("answers", "status", "seconds"), [(0, 503, 600), (0, 0, 60), (1, 0, 600)])
def test_an_endpoint_that_starts_is_waited_for(
    answers: int, status: int, seconds: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    def starting(failures: int) -> Scripted:
        failed = TryFailedError(status, "starting", retried=True, starting=True)
        return Scripted(fails=lambda number: failed if answers <= number < answers + failures else None)

    flown = fly(starting(12), tmp_path / "run", Options(concurrency=1, tries=2, backoff=0))
    assert (flown.result.verdict, flown.waits) == ("valid", [1.0] * 12)
    told = f"the endpoint may still be starting: waiting up to {seconds} s: {status or 'no answer'}: starting\n"
    assert capfd.readouterr().err.count(told) == 1
    flown = fly(starting(ALWAYS), tmp_path / "never", Options(concurrency=1, backoff=0))
    assert (flown.result.verdict, flown.seconds) == ("stopped", seconds)
    # One try is one try.
    flown = fly(starting(ALWAYS), tmp_path / "once", Options(concurrency=1, tries=1))
    assert (flown.result.verdict, flown.seconds) == ("stopped", 0)


def test_an_address_without_a_server_is_one_that_starts(endpoint: Start) -> None:
    address = f"127.0.0.1:{reserved_port()}"
    done = endpoint().infer("--base-url", f"http://{address}/v1", "--tries", "1")
    assert done.status == 2
    assert f"stopped: {address} gives no answer: {address} takes no connection (" in done.err
