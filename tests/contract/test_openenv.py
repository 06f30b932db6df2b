"""OpenEnv's clients, server and validator with our server and environment."""

import json
import sys
import uuid
from pathlib import Path
from typing import Any, cast

import pytest
import yaml
from starlette.testclient import TestClient
from typer.testing import CliRunner

from drone_env.core.actions import Action
from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from drone_env.errors import EpisodeError, InvalidValueError
from drone_env.graders import GRADERS
from drone_env.models import DroneAction, DroneObservation, DroneState
from drone_env.planning.optimal import solve
from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from drone_env.server.task_api import TaskApi
from tests.api.serving import Server
from tests.package.installed import copy_tracked
from tests.tools import PATIENCE, ROOT, ran

STANDARD = ["easy_delivery", "medium_delivery", "hard_delivery"]


def best_actions(task: str, seed: int) -> list[DroneAction]:
    return [DroneAction.model_validate({"direction": action.name}) for action in solve(task, seed).actions]


@pytest.mark.feature("E10")
def test_the_official_client_flies_synchronously(server: Server) -> None:
    from drone_env.openenv_client import DroneDeliveryClient

    task = "medium_delivery"
    flight = Episode(task, "score", 7)
    with DroneDeliveryClient(server.url).sync() as env:
        result = env.reset(seed=7, task_name=task, episode_id="mine")
        assert (result.reward, result.done) == (None, False)
        assert result.observation == DroneObservation.of(flight)
        with pytest.raises(InvalidValueError, match=r"step takes a DroneAction, such as .*; got 'UP'"):
            env.step(cast(DroneAction, "UP"))
        for action in best_actions(task, 7):
            result = env.step(action)
            assert result.reward == flight.step(Action[action.direction])
            assert result.observation == DroneObservation.of(flight)
        state = env.state()
        assert result.done
        assert result.observation.score == solve(task, 7).score
        assert state.episode_id == "mine"
        assert DroneState.model_validate(state.model_dump(exclude={"episode_id"})) == DroneState.of(flight)
        assert GRADERS[task](state.model_dump()) == result.observation.score


MESSAGES: list[dict[str, Any]] = [
    {"type": "reset", "data": {"seed": 7, "episode_id": "one", "task_name": "hard"}},
    {"type": "state"},
    *[{"type": "step", "data": {"direction": action.name}} for action in solve("hard", 7).actions],
    {"type": "state"},
    {"type": "step", "data": {"direction": "UP"}},
    {"type": "reset", "data": {"seed": 8, "episode_id": "two", "reward_profile": "aligned"}},
    {"type": "step", "data": {"direction": "WAIT", "metadata": {}}},
    {"type": "reset", "data": {"task_name": "skyline_easy", "seed": 9, "episode_id": "three", "prompt": "minimal"}},
    {"type": "step", "data": {"direction": "DOWN DOWN"}},
    {"type": "state"},
]


@pytest.mark.filterwarnings("default")
def test_our_socket_sends_what_openenvs_own_server_sends(tmp_path: Path) -> None:
    from openenv.core.env_server import create_fastapi_app

    from drone_env.server import grid_world_environment as ours

    messages = (ours.DroneEnvAction, ours.DroneEnvObservation)
    more: dict[str, Any] = {"max_concurrent_envs": 4, "state_cls": ours.DroneEnvState}
    theirs = create_fastapi_app(ours.DroneDeliveryEnvironment, *messages, **more)

    def frames(app: Any) -> list[Any]:
        with TestClient(app) as client, client.websocket_connect("/ws") as socket:
            answers = []
            for message in MESSAGES:
                socket.send_text(json.dumps(message))
                answers.append(json.loads(socket.receive_text()))
            return answers

    assert frames(create_app(Settings(data=tmp_path))) == frames(theirs)


class TestEnvironment:
    def test_it_begins_with_a_reset_and_its_rubric_has_the_last_score(self) -> None:
        from openenv.core.env_server.interfaces import Environment

        from drone_env.server.grid_world_environment import DroneDeliveryEnvironment, DroneEnvAction

        env = DroneDeliveryEnvironment("medium")
        assert isinstance(env, Environment)
        with pytest.raises(EpisodeError, match="reset"):
            env.step(DroneEnvAction(direction="UP"))
        observation = env.reset(seed=3)
        assert (env.state.task_name, env.state.seed, observation.reward) == ("medium_delivery", 3, None)
        assert uuid.UUID(env.state.episode_id)
        for action in solve("medium", 3).actions:
            observation = env.step(DroneEnvAction(direction=action.name))
        assert env.rubric is not None
        assert env.rubric.last_score == observation.score == solve("medium", 3).score


def test_the_validator_passes_the_running_server(server: Server) -> None:
    from openenv.cli._validation import validate_running_environment

    report = validate_running_environment(server.url, timeout_s=PATIENCE)
    assert report["summary"]["passed_count"] == report["summary"]["total_count"] == 6, report
    assert (report["passed"], report["mode"]) == (True, "simulation")


@pytest.mark.feature("P1")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_manifest_names_what_there_is_and_the_validator_passes_it(tmp_path: Path) -> None:
    from openenv.cli.__main__ import app

    manifest = yaml.safe_load((ROOT / "openenv.yaml").read_text(encoding="utf-8"))
    fixed = {"spec_version": 1, "type": "space", "runtime": "fastapi", "app": "drone_env.server.app:app", "port": 8000}
    assert manifest.items() >= fixed.items()
    levels = [TASKS[task] for task in STANDARD]
    assert manifest["tasks"] == [{"id": task.id, "grader": task.grader} for task in levels]
    assert manifest["graders"] == [{"id": task.grader} for task in levels]
    copy_tracked(tmp_path)  # no other test writes to this copy
    done = CliRunner().invoke(app, ["validate", str(tmp_path), "--level", "static"])
    assert done.exit_code == 0, done.output


def test_the_manifest_declares_what_a_client_discovers(server: Server) -> None:
    declared = yaml.safe_load((ROOT / "openenv.yaml").read_text(encoding="utf-8"))["validation"]["capabilities"]
    api = TaskApi()
    assert declared["declared_task_count"] == {one["name"]: api.num_tasks(one["name"]) for one in api.list_splits()}
    listed = server.client.post("/mcp", json={"jsonrpc": "2.0", "id": 1, "method": "tools/list"}).json()
    assert declared["declared_tools"] == [tool["name"] for tool in listed["result"]["tools"]]


def test_the_oracle_reaches_the_optimum_and_the_canaries_stay_at_the_floor(server: Server) -> None:
    reward = yaml.safe_load((ROOT / "openenv.yaml").read_text(encoding="utf-8"))["validation"]["reward"]
    done = ran(sys.executable, "validation/solve.py", "--url", server.url)
    assert done.returncode == 0, done.stderr
    oracle, *canaries = [float(line.rpartition(" ")[2]) for line in done.stdout.splitlines()]
    high = reward["range"][1]
    assert oracle >= high - reward["oracle_tolerance"]
    assert canaries == [0.01] * 9
    assert high - max(canaries) >= reward["floor_margin"]
