"""The drone as a taskset of verifiers, flown by its own `vf-eval`: `tools/verify.sh verifiers`."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from drone_env.flights.record import EpisodeRecord, replay
from drone_env.planning.optimal import solve
from tests.api.serving import serving
from tests.llm.conftest import Endpoint, Start, environment, json_lines

pytest.importorskip("verifiers", reason="needs an environment of its own", exc_type=ImportError)
# verifiers starts a process for each turn, and installs the packages of that process on its first run.
pytestmark = pytest.mark.timeout(1200)


def evaluated(endpoint: Endpoint, folder: Path, *arguments: str) -> list[dict[str, Any]]:
    """The traces of `vf-eval`."""
    where = ["--client.base-url", endpoint.url, "--client.api-key-var", "SCRIPTED_API_KEY", "--no-push", "--no-rich"]
    command = [str(Path(sys.executable).with_name("vf-eval")), *arguments, "--model", "scripted", *where]
    # Without uv on the path, verifiers downloads it.
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    subprocess.run(command, cwd=folder, env=environment(SCRIPTED_API_KEY="sk-scripted", PATH=path), check=True)
    (path,) = folder.glob("outputs/*/traces.jsonl")
    traces = [trace for line in json_lines(path) for trace in line.get("traces", [line])]
    for trace in traces:
        assert trace["ok"], trace["errors"]
    return traces


def flown(endpoint: Endpoint, folder: Path, *arguments: str) -> list[dict[str, Any]]:
    """The traces of our taskset."""
    traces = evaluated(endpoint, folder, "drone_delivery", *arguments)
    for trace in traces:
        assert sum(trace["info"]["turn_rewards"]) == pytest.approx(-trace["metrics"]["regret"])
        replay(EpisodeRecord.model_validate_json(trace["info"]["record"]))
    return traces


def test_plans_in_one_turn(endpoint: Start, tmp_path: Path) -> None:
    traces = flown(endpoint(pilot="plan"), tmp_path, "--env.taskset.map-task", "hard", "--select.limit", "2")
    scores = {trace["task"]["data"]["flight"][1]: trace["rewards"]["score"]["score"] for trace in traces}
    assert scores == {seed: solve("hard", seed).score for seed in (0, 1)}
    assert all(trace["info"]["turn_rewards"] == [0] and trace["metrics"]["success"] == 1 for trace in traces)


def test_turn_by_turn_the_credit_is_the_change_of_the_best_score(endpoint: Start, tmp_path: Path) -> None:
    limits = ["--env.pilot.max-turns", "4", "--select.limit", "1", "--env.taskset.prompt", "minimal"]
    scripted = endpoint(pilot="WAIT")
    (trace,) = flown(scripted, tmp_path, *limits)
    assert (trace["metrics"]["steps"], trace["metrics"]["success"]) == (4, 0)
    *steps, last = trace["info"]["turn_rewards"]
    assert steps == pytest.approx([-0.2 / 60] * 3)  # a step and a unit of battery
    assert last < -0.9  # the limit: nothing is delivered
    (folder := tmp_path / "bad").mkdir()
    (trace,) = flown(endpoint(pilot="Let us go up!"), folder, *limits)
    assert (trace["metrics"]["steps"], trace["metrics"]["unusable"]) == (2, 1)
    # The first unusable answer of a step is repaired, the second is a WAIT.
    assert trace["info"]["turn_rewards"][:3] == pytest.approx([0, -0.2 / 60, 0])


def test_a_limit_that_ends_the_first_turn_costs_all_that_could_be_reached(endpoint: Start, tmp_path: Path) -> None:
    limit = ["--env.pilot.max-turns", "0", "--select.limit", "1"]
    (trace,) = flown(endpoint(pilot="plan"), tmp_path, *limit)
    assert trace["info"]["turn_rewards"] == [-trace["metrics"]["regret"]]
    assert trace["metrics"]["regret"] > 0.9


def test_its_own_openenv_taskset_flies_over_our_server(endpoint: Start, tmp_path: Path) -> None:
    route = " ".join(action.name for action in solve("easy", 7).actions)
    with serving(tmp_path / "data") as server:
        (tmp_path / "easy.toml").write_text(
            f"[env.taskset]\nid = 'openenv'\nbase_url = '{server.url}'\n"
            "resets = [{ task_name = 'easy', seed = 7, prompt = 'minimal' }]\n"
            "[env.player]\nharness = { id = 'null' }\nruntime = { type = 'subprocess' }\n"
        )
        (trace,) = evaluated(endpoint(pilot=route), tmp_path, "@", "easy.toml")
    assert trace["rewards"]["openenv_reward"]["score"] == solve("easy", 7).score
