"""A language model flies on two nodes: one budget, one transcript, the report of the local run."""

import json
import os
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from drone_env.llm.report import report as figures_of
from drone_env.llm.verify import verified_run
from tests.llm.conftest import TOKEN, Endpoint, Infer

from .conftest import MEMORY

FLIGHTS = int(os.environ.get("DRONE_ENV_CLUSTER_FLIGHTS", "6"))
FIGURES = ("flights.jsonl", "episodes.jsonl")


def most_at_once(endpoint: Endpoint) -> int:
    """The most requests that were under way together; what was answered is a second line in the log."""
    now = most = 0
    for line in map(json.loads, endpoint.log.read_text().splitlines()):
        now += 1 if "body" in line else -1
        most = max(most, now)
    return most


def without_times(run: Infer) -> list[dict[str, Any]]:
    calls = [{name: value for name, value in call.items() if name not in ("at", "latency")} for call in run.calls]
    return sorted(calls, key=lambda call: (call["flight"], call["turn"], call["attempt"]))


def report(run: Infer) -> dict[str, Any]:
    """The report, but for the endpoint's name and for how long it took."""
    figures = figures_of(verified_run(run.folder), moves=False)
    figures["config"]["base_url"] = figures["latency_median"] = None
    return figures


@pytest.mark.timeout(36_000)
def test_two_nodes_keep_the_rate_and_fly_as_one(cluster: Any, endpoint: Callable[..., Endpoint]) -> None:
    # One is overloaded in its middle, so that the shared budget has to shrink as well.
    script: dict[str, Any] = {"pilot": "greedy", "latency": 0.05, "faults": [[9, 9, {"status": 429}]]}
    flights = ("--task", "easy", "--seeds", f"14:{14 + FLIGHTS}", "--concurrency", "4")
    alone, together = endpoint(**script), endpoint(**script)
    local = alone.infer(*flights)
    pace = ("--requests-per-minute", "600", "--engine", "ray", "--address", cluster.address)
    on_ray = together.infer(*flights, *pace)
    assert (local.status, on_ray.status) == (0, 0), local.err + on_ray.err
    assert sorted(on_ray.out.splitlines()) == sorted(local.out.splitlines())
    for name in FIGURES:
        assert (on_ray.folder / name).read_text() == (local.folder / name).read_text()
    assert report(on_ray) == report(local)
    # Which call met the overload depends on their order.
    answers = [{**call, "failures": None} for call in without_times(on_ray)]
    assert answers == [{**call, "failures": None} for call in without_times(local)]
    assert most_at_once(together) <= 4
    sent = [request["at"] for request in together.requests()]
    for i, at in enumerate(sent):
        # 600 a minute are 10 a second; one more is the slot that may be made up for.
        assert sum(at <= other < at + 1.0 for other in sent[i:]) <= 12
    ports = {request["headers"]["authorization"] for request in together.requests()}
    assert ports == {f"Bearer {TOKEN}"}
    again = together.infer(*flights, "--resume", folder=on_ray.folder)
    assert (again.status, len(together.requests())) == (0, len(sent))


@pytest.mark.timeout(36_000)
def test_a_node_killed_among_its_calls(cluster: Any, endpoint: Callable[..., Endpoint]) -> None:
    scripted, undisturbed = endpoint(pilot="greedy", latency=0.3), endpoint(pilot="greedy")
    flights = ("--task", "easy", "--seeds", f"14:{14 + FLIGHTS}", "--concurrency", "4")

    def kill_a_node() -> None:
        calls = scripted.folder / f"{scripted.log.stem}-run-0" / "calls.jsonl"
        while not calls.exists() or calls.read_bytes().count(b"\n") < 5:
            time.sleep(0.01)
        cluster.remove_node(next(iter(cluster.worker_nodes)), allow_graceful=False)

    killer = threading.Thread(target=kill_a_node, daemon=True)
    killer.start()
    done = scripted.infer(*flights, "--engine", "ray", "--address", cluster.address)
    killer.join(60)
    cluster.add_node(num_cpus=1, object_store_memory=MEMORY)
    assert done.status == 0, done.err
    assert done.flights == undisturbed.infer(*flights).flights
    keys = [(call["flight"], call["turn"], call["attempt"]) for call in done.calls]
    assert len(keys) == len(set(keys))
    # Asked twice is only what was under way on the node that died.
    asked = [request["call"] for request in scripted.requests()]
    assert len(asked) - len(set(asked)) <= 4
