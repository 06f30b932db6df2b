"""Two nodes send the requests of a run: one budget, one transcript, the report of the local run."""

import os
import time
from typing import Any

import pytest

from drone_env.llm.report import report as figures_of
from drone_env.llm.verify import verified_run
from tests.llm.conftest import TOKEN, Infer, Start, whole_lines

from .conftest import node_killed_when

pytestmark = [pytest.mark.long, pytest.mark.timeout(36_000)]
FLIGHTS = int(os.environ.get("DRONE_ENV_CLUSTER_FLIGHTS", "6"))


def without_times(run: Infer) -> list[dict[str, Any]]:
    """The calls, without what depends on when they were made: which of them met the overload, too."""
    calls = [{**call, "at": None, "latency": None, "failures": None} for call in run.calls]
    return sorted(calls, key=lambda call: (call["flight"], call["turn"], call["attempt"]))


def report(run: Infer) -> dict[str, Any]:
    """The report, but for the endpoint's name, how long it took, and what was asked twice."""
    figures = figures_of(verified_run(run.folder), moves=False)
    figures["config"]["base_url"] = figures["latency_median"] = figures["calls"]["requests"] = None
    return figures


def most_at_once(lines: list[dict[str, Any]]) -> int:
    """The most requests that were under way together; the end of each is a line of its own."""
    now = most = 0
    for line in lines:
        now += 1 if "body" in line else -1
        most = max(most, now)
    return most


def test_nodes_share_one_budget_and_fly_as_one_though_one_is_killed(cluster: Any, endpoint: Start) -> None:
    flights = ("--task", "easy", "--seeds", f"14:{14 + FLIGHTS}", "--concurrency", "4")
    on_nodes = ("--engine", "ray", "--address", cluster.address)
    alone = endpoint(pilot="greedy")
    local = alone.infer(*flights)
    # One is overloaded in its middle, so that the shared budget has to shrink as well.
    together = endpoint(pilot="greedy", latency=0.3, faults=[[9, 9, {"status": 429}]])
    # Two may go at once and the third 10 s after them, whichever nodes they come from: with a pace for each node, three
    # would go at once. Load can only make it longer.
    began = time.monotonic()
    first = together.infer(*flights, *on_nodes, "--requests-per-minute", "6", "--max-calls", "3")
    took = time.monotonic() - began
    assert first.status == 3, first.err
    assert (len(together.requests()), took >= 10) == (3, True)

    calls = first.folder / "calls.jsonl"
    before_the_end: list[dict[str, Any]] = []

    def in_the_middle() -> bool:
        before_the_end[:] = together.log
        return len(whole_lines(calls)) >= 12

    with node_killed_when(cluster, in_the_middle):
        done = together.infer(*flights, *on_nodes, "--resume", folder=first.folder)
    assert done.status == 0, done.err
    assert 1 <= most_at_once(before_the_end) <= 4
    assert sorted(done.out.splitlines()) == sorted(local.out.splitlines())
    for name in ("flights.jsonl", "episodes.jsonl"):
        assert (done.folder / name).read_text() == (local.folder / name).read_text()
    assert report(done) == report(local)
    assert without_times(done) == without_times(local)
    # Asked twice is only what met the overload, and what was under way on the node that died.
    asked = [request["call"] for request in together.requests()]
    assert 1 <= len(asked) - len(set(asked)) <= 1 + 4
    assert len([call for call in done.calls if call["failures"]]) <= 1 + 4
    assert {request["headers"]["authorization"] for request in together.requests()} == {f"Bearer {TOKEN}"}
    # What was flown on nodes is gone on with here, and nothing is asked again.
    again = together.infer(*flights, "--resume", folder=done.folder)
    assert (again.status, len(together.requests())) == (0, len(asked))
