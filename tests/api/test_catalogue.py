"""What the server says there is, its logs, its predictions, and its description of itself."""

from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from starlette.testclient import TestClient

from drone_env import __version__
from drone_env.agents import make_agent
from drone_env.agents.pathqnet import PathQNetAgent
from drone_env.agents.tour_network import load_tour_network
from drone_env.client import DroneEnvClient, ServerError
from drone_env.core.actions import Action
from drone_env.core.episode import Episode, rollout
from drone_env.core.rules import score_of
from drone_env.core.tables import interpreted
from drone_env.core.tasks import TASKS, get_task
from drone_env.errors import CheckpointError
from drone_env.models import NAMES
from drone_env.server.logs import KEPT, LONGEST_PATH, RequestLog
from drone_env.server.routes.catalogue import SCORE_WEIGHTS
from drone_env.server.routes.flight import Prediction
from tests.api.networks import put_network, put_tour, put_trained

Header = dict[str, str]


class TestLogs:
    @pytest.mark.feature("H9")
    def test_requests_are_logged_without_what_they_carried(self, client: TestClient) -> None:
        session = client.post("/reset?secret=query", json={"agent": "secret body"}).json()["session_id"]
        client.get("/state", headers={"X-Session-Id": session})
        # What would change a terminal is logged as it was sent.
        client.get("/nowhere%1B%C2%9B%E2%80%AE%C3%A9")
        answer = client.get("/terminal_logs")
        logged = answer.json()["requests"]
        assert [(r["method"], r["path"], r["status"]) for r in logged] == [
            ("POST", "/reset", 200),
            ("GET", "/state", 200),
            ("GET", "/nowhere%1B%C2%9B%E2%80%AE\u00e9", 404),
        ]
        assert "secret" not in answer.text
        assert session not in answer.text

    def test_what_is_kept_in_memory_is_bounded(self) -> None:
        log = RequestLog()
        for _ in range(KEPT + 50):
            log.add("GET", "/" + "x" * 1000, 200, 0.0)
        logged = log.since(0)
        assert (len(logged), logged[0].number, logged[-1].number) == (KEPT, 51, KEPT + 50)
        assert {len(entry.path) for entry in logged} == {LONGEST_PATH}
        assert [entry.number for entry in log.since(KEPT + 48)] == [KEPT + 49, KEPT + 50]


def tasks_of(client: TestClient) -> dict[str, list[str]]:
    """The tasks that each pilot can fly."""
    return {pilot["id"]: pilot["tasks"] for pilot in client.get("/pilots").json()["pilots"]}


class TestPredictions:
    @pytest.fixture
    def settings(self, tmp_path: Path) -> dict[str, Any]:
        """An application with networks of two tasks."""
        for task in ("easy", "skyline_easy"):
            put_network(get_task(task), tmp_path)
        return {"data": tmp_path / "data", "weights": tmp_path}

    @pytest.mark.parametrize("task", ["easy", "skyline_easy"])
    def test_the_network_is_asked_about_the_session(
        self, client: TestClient, settings: dict[str, Any], task: str
    ) -> None:
        config = get_task(task)
        reset = client.post("/reset", json={"task_name": task, "seed": 7}).json()
        session = {"X-Session-Id": reset.pop("session_id")}
        answer = client.post("/predict", headers=session)
        told = Prediction.model_validate(answer.json())
        episode = Episode(task)
        episode.reset(7)
        agent = PathQNetAgent(config, settings["weights"] / f"{config.id}_v{config.version}.safetensors")
        values = agent.q_values(episode.observation())
        assert list(told.q_values.values()) == pytest.approx(values.tolist())
        assert told.action == Action(int(values.argmax())).name
        assert told.model.digest == agent.config["network"]

    @pytest.mark.feature("L7")
    def test_what_was_trained_here_goes_before_what_is_shipped(
        self, client: TestClient, settings: dict[str, Any], session: Header
    ) -> None:
        """Also what is trained while the server runs, and trained again."""

        def told() -> tuple[str, str, list[float]]:
            prediction = client.post("/predict", headers=session).json()
            return prediction["model"]["file"], prediction["model"]["digest"], list(prediction["q_values"].values())

        shipped = told()
        assert shipped[0] == "easy_delivery_v1.safetensors"
        assert "trained" not in tasks_of(client)
        for times in (-1, -2):
            file = put_trained(get_task("easy"), settings["data"], times)
            digest = PathQNetAgent(get_task("easy"), file).config["network"]
            assert told() == ("easy.safetensors", digest, pytest.approx([times * value for value in shipped[2]]))
        assert tasks_of(client)["trained"] == ["easy_delivery"]
        assert tasks_of(client)["pathqnet"] == ["easy_delivery", "skyline_easy"]
        file.unlink()
        assert told() == shipped

    def test_without_a_readable_file_nothing_flies_in_its_stead(
        self, client: TestClient, settings: dict[str, Any], session: Header
    ) -> None:
        other = {"X-Session-Id": client.post("/reset", json={"task_name": "hard"}).json()["session_id"]}
        missing = client.post("/predict", headers=other)
        assert (missing.status_code, "Retry-After" in missing.headers) == (503, False)
        (settings["data"] / "easy.safetensors").write_bytes(b"nothing")
        answer = client.post("/predict", headers=session)
        assert (answer.status_code, answer.json()["code"]) == (503, "no_network")
        assert "easy.safetensors is not an exported network" in answer.json()["detail"]
        assert "trained" not in tasks_of(client)

    def test_a_tour_network_flies_every_task_and_one_of_a_single_task_goes_before(
        self, client: TestClient, settings: dict[str, Any]
    ) -> None:
        def flown_by(task: str) -> object:
            return client.app.state.shared.networks.agent("trained-tournet", get_task(task)).config["network"]  # type: ignore[attr-defined]

        assert tasks_of(client)["tournet"] == []
        put_tour(settings["weights"] / "tournet_v1.safetensors")
        assert tasks_of(client)["tournet"] == list(TASKS)
        alone = put_tour(settings["data"] / "tournet_hard.safetensors", 1)
        assert tasks_of(client)["trained-tournet"] == ["hard_delivery"]
        every = put_tour(settings["data"] / "tournet.safetensors", 2)
        assert tasks_of(client)["trained-tournet"] == list(TASKS)
        digests = [load_tour_network(file).digest for file in (alone, every)]
        assert [flown_by("hard"), flown_by("easy")] == digests
        every.write_bytes((settings["weights"] / "easy_delivery_v1.safetensors").read_bytes())
        assert tasks_of(client)["trained-tournet"] == ["hard_delivery"]
        with pytest.raises(CheckpointError, match=r"tournet\.safetensors holds a network of 'pathqnet', not"):
            flown_by("easy")

    def test_after_the_end_there_is_nothing_to_predict(self, client: TestClient, session: Header) -> None:
        observation: dict[str, Any] = {"done": False}
        while not observation["done"]:
            observation = client.post("/step", json={"direction": "WAIT"}, headers=session).json()
        assert client.post("/predict", headers=session).status_code == 409


def test_the_api_is_described(shared_client: TestClient) -> None:
    info = shared_client.get("/openapi.json").json()["info"]
    assert (info["version"], "opens a session" in info["description"]) == (__version__, True)


def test_openenvs_routes(client: TestClient) -> None:
    assert client.get("/metadata").json()["version"] == __version__
    assert len(client.get("/drone-env/splits").json()) == 3 * len(TASKS)
    test = {"split": "hard_delivery/test"}
    one = client.post("/drone-env/task", json=test | {"index": 2}).json()["task"]
    assert (one["seed"], one["id"]) == (2**52 + 2**51 + 2, "hard_delivery/test/2")
    assert client.post("/drone-env/task_range", json=test | {"start": 2, "stop": 3}).json() == {"tasks": [one]}
    listed = client.post("/drone-env/task_range", json={"split": "skyline_easy/train", "stop": 20}).json()["tasks"]
    for task in listed:
        flown = rollout(Episode("skyline_easy", seed=task["seed"]), make_agent("greedy", "skyline_easy").act)
        assert (task["group"], task["difficulty"]) == ("skyline_easy", round(1 - flown.score, 1))
    assert len({task["difficulty"] for task in listed}) > 2
    assert "difficulty" not in client.post("/drone-env/task", json={"split": "city/train", "index": 0}).json()["task"]
    assert client.post("/drone-env/task", json=test | {"index": -1}).status_code == 400
    assert client.post("/drone-env/task_range", json=test | {"start": 0, "stop": 1001}).status_code == 422
    assert client.get("/other/splits").status_code == 404


def test_what_tasks_tell_of_rewards_and_drain_is_what_steps_pay(shared_client: TestClient) -> None:
    paid: set[tuple[str, int]] = set()
    for told in shared_client.get("/tasks").json()["tasks"]:
        assert told["rewards"]["aligned"] == told["rewards"]["score"] == {}
        for profile in ("tiered", "composite"):
            episode, chance = Episode(told["id"], profile, 7), np.random.default_rng(7)
            while not episode.ended:
                before, target, units = episode.position, episode.target, episode.battery_units
                reward = episode.step(int(chance.integers(5)))
                pays = told["rewards"][profile][episode.event.name.lower()]
                assert target is not None
                (x, y), (was_x, was_y) = episode.position, before
                far = abs(x - target[0]) + abs(y - target[1])
                closer = abs(was_x - target[0]) + abs(was_y - target[1]) - far
                assert reward == pays[closer + 1 if len(pays) == 3 else 0]
                if NAMES[episode.under] != "pad":
                    assert episode.battery_units == max(0, units - told["drain"][NAMES[episode.under]])
                paid.add((episode.event.name, len(pays)))
    assert {("STEP", 3), ("TREE", 3), ("WAIT", 1), ("WALL", 1)} <= paid


def test_the_weights_of_a_score_are_those_of_the_rules() -> None:
    task = TASKS["easy_delivery"]
    left = ((0, task.max_steps), (task.battery_capacity, task.max_steps), (0, 0))
    parcels, charged, at_once = (
        round(100 * score_of(interpreted(task), task.deliveries, units, steps)) for units, steps in left
    )
    assert {"parcels": parcels, "battery": charged - parcels, "steps": at_once - parcels} == SCORE_WEIGHTS


class TestClientInProcess:
    def test_it_flies(self, client: TestClient, capsys: pytest.CaptureFixture[str]) -> None:
        with DroneEnvClient(http=client) as drone:
            assert drone.health()["status"] == "healthy"
            result = drone.run_random_episode("easy_delivery", verbose=True)
            assert len(capsys.readouterr().out.splitlines()) == result["steps"]
            assert drone.grade("easy")["score"] == result["score"]
            assert drone.analyse("easy")["episodes_total"] == 1
            assert drone.path_history()["step_count"] == drone.state()["step_count"] == result["steps"]
            assert [task["id"] for task in drone.tasks()["tasks"]] == list(TASKS)

    @pytest.mark.parametrize("status", [200, 307, 500])
    @pytest.mark.parametrize("text", ["<html>another server</html>", '["another server"]'])
    def test_what_no_server_of_ours_answers_is_an_error(self, status: int, text: str) -> None:
        answer = httpx.Response(status, text=text)
        http = httpx.Client(base_url="http://other", transport=httpx.MockTransport(lambda _: answer))
        with pytest.raises(ServerError, match="GET /health") as wrong:
            DroneEnvClient(http=http).health()
        assert wrong.value.status == answer.status_code

    def test_it_ends_its_session_when_it_is_closed_unless_it_is_to_keep_it(self, client: TestClient) -> None:
        kept, ended = DroneEnvClient(http=client), DroneEnvClient(http=client)
        with pytest.raises(ServerError, match="POST /step") as early:
            kept.step("UP")
        assert (early.value.status, early.value.code) == (409, "no_session")
        for drone in (kept, ended):
            drone.reset("easy", seed=7)
        client.cookies.clear()
        kept.close(keep_session=True)
        ended.close()
        assert kept.state()["step_count"] == 0
        assert ended.session_id is None
        with pytest.raises(ServerError, match="no session"):
            ended.state()

    def test_it_sends_the_token_that_it_is_given_or_finds(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("DRONE_ENV_TOKEN", "found")
        for token, sent in ((None, "Bearer found"), ("given", "Bearer given")):
            with DroneEnvClient("http://other", token=token) as drone:
                assert drone._http.headers["Authorization"] == sent
