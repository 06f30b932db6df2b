"""Flying over HTTP: reset, step, sessions, and what there is to know about an episode."""

import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.client import DroneEnvClient
from drone_env.core.state_manager import Episode
from drone_env.core.tasks import TASKS
from drone_env.episodes.finished import check_agent
from drone_env.episodes.record import replay
from drone_env.episodes.store import FILE_NAME, Store
from drone_env.errors import InvalidValueError
from drone_env.graders import GRADERS
from drone_env.models import DroneObservation, DroneState
from drone_env.planning.optimal import solve
from drone_env.server.app import create_app
from drone_env.server.schemas import FlatReset, PathHistory, ResetResult, SolutionAnswer, StepResult
from drone_env.server.settings import Settings
from tests.api.conftest import Clock

Header = dict[str, str]
UP = {"direction": "UP"}


def flown(task: str, seed: int, actions: int = 0) -> Episode:
    """An episode after the first actions of the best flight."""
    episode = Episode(task)
    episode.reset(seed)
    for action in solve(task, seed).actions[:actions]:
        episode.step(action)
    return episode


def finish(client: TestClient, task: str, seed: int) -> tuple[Header, dict[str, Any]]:
    """Fly the best flight; the session and the last observation."""
    reset = client.post("/reset", json={"task_name": task, "seed": seed, "agent": "tester"}).json()
    session = {"X-Session-Id": reset["session_id"]}
    last: dict[str, Any] = {}
    for action in solve(task, seed).actions:
        last = client.post("/step", json={"direction": action.name}, headers=session).json()
    return session, last


@pytest.mark.parametrize("task", TASKS)
def test_every_task_is_flown_as_the_rules_say(client: TestClient, task: str) -> None:
    body = client.post("/reset", json={"task_name": task, "seed": 3}).json()
    session = {"X-Session-Id": body["session_id"]}
    episode = flown(task, 3)
    assert (
        FlatReset.model_validate(body).model_dump(exclude={"session_id"}) == DroneObservation.of(episode).model_dump()
    )
    for direction in ("UP", "LEFT", "WAIT", "DOWN", "RIGHT", "UP"):
        answer = client.post("/step", json={"direction": direction}, headers=session)
        episode.step(["UP", "DOWN", "LEFT", "RIGHT", "WAIT"].index(direction))
        assert answer.status_code == 200
        assert DroneObservation.model_validate(answer.json()) == DroneObservation.of(episode)
    assert DroneState.model_validate(client.get("/state", headers=session).json()) == DroneState.of(episode)
    history = PathHistory.model_validate(client.get("/path_history", headers=session).json())
    assert history.path == DroneState.of(episode).path_history
    grade = client.get(f"/grade/{task}", headers=session).json()
    assert grade == {"task": task, "score": episode.score, "done": False}


def test_the_graders_and_short_names_are_accepted_wherever_a_task_is_named(client: TestClient) -> None:
    for name in ("hard", "hard_delivery", "drone_env.graders:grade_hard"):
        session = {"X-Session-Id": client.post("/reset", json={"task_name": name}).json()["session_id"]}
        assert client.get(f"/grade/{name}", headers=session).json()["task"] == "hard_delivery"
        assert client.get(f"/analyse/{name}").json()["task"] == "hard_delivery"


def test_openenvs_form_of_a_step_is_answered_in_openenvs_form(client: TestClient, session: Header) -> None:
    flat = client.post("/step", json={"direction": "UP"}, headers=session).json()
    body = {"action": {"direction": "WAIT", "metadata": {"why": "because"}}, "timeout_s": 30, "request_id": "r"}
    answer = client.post("/step", json=body, headers=session).json()
    StepResult.model_validate(answer)
    assert answer["observation"].keys() == (flat.keys() | {"metadata"}) - {"done"}
    assert (answer["reward"], answer["done"]) == (answer["observation"]["reward_last"], False)


def test_openenvs_form_of_a_reset_is_answered_in_openenvs_form(client: TestClient) -> None:
    answer = client.post("/reset", json={"episode_id": "mine", "seed": 7}).json()
    ResetResult.model_validate(answer)
    assert (answer["reward"], answer["done"], answer["observation"]["step_count"]) == (None, False, 0)


@pytest.mark.parametrize(
    "body",
    [
        {},
        {"direction": "UP", "action": {"direction": "UP"}},
        {"direction": None},
        {"direction": "up"},
        {"direction": 0},
        {"direction": "UP", "speed": 2},
        {"action": {}},
        {"action": {"direction": "UP", "speed": 2}},
        [],
        "UP",
    ],
)
def test_a_step_that_is_none_is_refused_and_changes_nothing(client: TestClient, session: Header, body: Any) -> None:
    answer = client.post("/step", json=body, headers=session)
    assert answer.status_code == 422
    assert answer.json()["code"] == "invalid_request"
    assert answer.json()["errors"]
    assert client.get("/state", headers=session).json()["step_count"] == 0


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ({"task_name": "none"}, "allowed: easy, easy_delivery"),
        ({"reward_profile": "none"}, "allowed: aligned"),
        ({"seed": -1}, "body.seed"),
        ({"seed": 2**53}, "body.seed"),
        ({"seed": "7"}, "body.seed"),
        ({"seed": 7.0}, "body.seed"),
        ({"colour": "red"}, "body.colour"),
        ({"agent": "two\nlines"}, "one printable line"),
        ({"split": "easy_delivery/nowhere", "index": 1}, "easy_delivery/test"),
        ({"split": "easy_delivery/test", "index": 2**51}, "there is no number"),
    ],
)
def test_a_reset_that_is_refused_leaves_the_episode_as_it_was(
    client: TestClient, session: Header, body: Any, told: str
) -> None:
    client.post("/step", json={"direction": "UP"}, headers=session)
    answer = client.post("/reset", json=body, headers=session)
    assert answer.status_code == 422
    assert told in answer.json()["detail"]
    assert client.get("/state", headers=session).json()["step_count"] == 1


@pytest.mark.parametrize(
    "name", ["a\u00a0b", "\u3000", "a\u2028b", "a\u200bb", "a\tb", "\ue000", "a" * 200, "a" * 201, ""]
)
def test_an_agent_is_named_as_records_name_it(client: TestClient, name: str) -> None:
    try:
        check_agent(name)
    except InvalidValueError:
        allowed = 422
    else:
        allowed = 200
    assert client.post("/reset", json={"agent": name}).status_code == allowed


def test_an_empty_body_resets(client: TestClient) -> None:
    for answer in (client.post("/reset"), client.post("/reset", json={})):
        assert answer.status_code == 200
        assert answer.json()["grid_width"] == 10


def test_a_reset_in_a_session_stays_in_it_and_walks_on(client: TestClient, session: Header) -> None:
    answer = client.post("/reset", headers=session)
    walk = flown("easy_delivery", 7)
    assert answer.json()["session_id"] == session["X-Session-Id"] == answer.headers["X-Session-Id"]
    assert client.get("/state", headers=session).json()["seed"] == walk.reset()


def test_after_the_end_a_step_changes_nothing_and_pays_nothing(client: TestClient) -> None:
    session, last = finish(client, "easy", 7)
    answer = client.post("/step", json={"action": {"direction": "UP"}}, headers=session).json()
    assert answer["reward"] == 0.0
    assert answer["observation"]["message"].startswith("Nothing done")
    assert answer["observation"]["step_count"] == last["step_count"]
    assert len(client.get("/memory_logs").json()["episodes"]) == 1


class TestSessions:
    def test_the_three_ways_to_be_told_a_session_agree(self, client: TestClient) -> None:
        answer = client.post("/reset")
        session = answer.json()["session_id"]
        assert answer.headers["X-Session-Id"] == session
        cookie = answer.headers["Set-Cookie"]
        assert cookie.startswith(f"drone_env_session={session};")
        assert "HttpOnly" in cookie
        assert "SameSite=lax" in cookie
        assert len(session) >= 32

    def test_over_https_the_cookie_works_in_a_frame(self, client: TestClient) -> None:
        cookie = client.post("https://testserver/reset").headers["Set-Cookie"]
        assert "Secure" in cookie
        assert "SameSite=none" in cookie

    def test_the_cookie_names_the_session_and_the_header_goes_before_it(
        self, client: TestClient, session: Header
    ) -> None:
        client.post("/step", json={"direction": "UP"}, headers=session)
        cookie = {"Cookie": f"drone_env_session={session['X-Session-Id']}"}
        assert client.get("/state", headers=cookie).json()["step_count"] == 1
        other = {"X-Session-Id": client.post("/reset").json()["session_id"]}
        assert client.get("/state", headers=cookie | other).json()["step_count"] == 0

    @pytest.mark.parametrize(
        ("method", "path", "body"),
        [
            ("POST", "/step", {"direction": "UP"}),
            ("GET", "/state", None),
            ("GET", "/grade/easy", None),
            ("GET", "/path_history", None),
            ("GET", "/solution", None),
            ("POST", "/predict", None),
        ],
    )
    def test_without_a_session_one_is_told_what_to_do(
        self, client: TestClient, method: str, path: str, body: Any
    ) -> None:
        none = client.request(method, path, json=body)
        assert (none.status_code, none.json()["code"]) == (409, "no_session")
        for nothing in ({"X-Session-Id": ""}, {"Cookie": "drone_env_session="}):
            assert client.request(method, path, json=body, headers=nothing).status_code == 409
        gone = client.request(method, path, json=body, headers={"X-Session-Id": "never"})
        assert (gone.status_code, gone.json()["code"]) == (410, "session_gone")
        assert "POST /reset" in gone.json()["detail"]

    def test_a_reset_that_names_a_session_that_is_gone_opens_another(self, client: TestClient) -> None:
        answer = client.post("/reset", headers={"X-Session-Id": "never"})
        assert answer.status_code == 200
        assert answer.json()["session_id"] != "never"

    def test_sessions_do_not_see_each_other(self, client: TestClient) -> None:
        sessions = [{"X-Session-Id": client.post("/reset", json={"seed": i}).json()["session_id"]} for i in range(20)]
        for steps in range(1, 4):
            for session in sessions:
                client.post("/step", json={"direction": "WAIT"}, headers=session)
            states = [client.get("/state", headers=session).json() for session in sessions]
            assert [(s["seed"], s["step_count"]) for s in states] == [(i, steps) for i in range(20)]

    def test_one_session_more_than_there_is_room_for_is_refused(self, tmp_path: Path) -> None:
        with TestClient(create_app(Settings(data=tmp_path, capacity=2))) as client:
            first = client.post("/reset").json()["session_id"]
            client.cookies.clear()
            assert client.post("/reset").status_code == 200
            client.cookies.clear()
            full = client.post("/reset")
            assert (full.status_code, full.json()["code"]) == (503, "no_room")
            assert full.headers["Retry-After"] == "5"
            assert client.post("/reset", headers={"X-Session-Id": first}).status_code == 200

    def test_an_idle_session_ends_by_itself(
        self, tmp_path: Path, clock: Clock, eventually: Callable[..., None]
    ) -> None:
        # Looked for every 0.1 s; idle by the test's clock alone.
        with TestClient(create_app(Settings(data=tmp_path, idle_seconds=0.4), clock)) as client:
            session = {"X-Session-Id": client.post("/reset").json()["session_id"]}
            clock.now += 1
            eventually(lambda: client.get("/state", headers=session).status_code == 410)

    def test_an_idle_session_makes_room_and_reading_does_not_keep_it(self, tmp_path: Path, clock: Clock) -> None:
        with TestClient(create_app(Settings(data=tmp_path, capacity=1), clock)) as client:
            session = {"X-Session-Id": client.post("/reset").json()["session_id"]}
            client.cookies.clear()
            clock.now += 800
            assert client.post("/step", json={"direction": "WAIT"}, headers=session).status_code == 200
            clock.now += 899
            assert client.get("/state", headers=session).status_code == 200
            assert client.post("/reset").status_code == 503
            clock.now += 1
            assert client.post("/reset").status_code == 200
            assert client.get("/state", headers=session).status_code == 410

    def test_a_session_is_there_after_a_restart(self, tmp_path: Path) -> None:
        with TestClient(create_app(Settings(data=tmp_path))) as client:
            session = {"X-Session-Id": client.post("/reset", json={"seed": 7}).json()["session_id"]}
            seen = client.post("/step", json={"direction": "UP"}, headers=session).json()
        with TestClient(create_app(Settings(data=tmp_path))) as client:
            assert client.get("/state", headers=session).json()["step_count"] == 1
            after = client.post("/step", json={"direction": "WAIT"}, headers=session).json()
        assert after["reward_total"] == pytest.approx(seen["reward_total"] + after["reward_last"])
        assert after["step_count"] == 2

    def test_two_servers_on_one_folder_fly_one_session(self, tmp_path: Path) -> None:
        with (
            TestClient(create_app(Settings(data=tmp_path))) as one,
            TestClient(create_app(Settings(data=tmp_path))) as two,
        ):
            session = {"X-Session-Id": one.post("/reset", json={"task_name": "hard", "seed": 7}).json()["session_id"]}
            expected = flown("hard", 7)
            for i, action in enumerate(solve("hard", 7).actions):
                client = (one, two)[i % 2]
                answer = client.post("/step", json={"direction": action.name}, headers=session).json()
                expected.step(action)
                assert answer == DroneObservation.of(expected).model_dump(mode="json")
            assert one.post("/reset", json={"seed": 1}, headers=session).status_code == 200
            assert two.get("/state", headers=session).json()["seed"] == 1


class TestAfterTheEnd:
    def test_the_best_flight_is_told_only_then(self, client: TestClient, session: Header) -> None:
        early = client.get("/solution", headers=session)
        assert (early.status_code, early.json()["code"]) == (409, "in_flight")
        session, last = finish(client, "hard", 7)
        told = SolutionAnswer.model_validate(client.get("/solution", headers=session).json())
        best = solve("hard", 7)
        assert told.optimal_score == told.score == last["score"] == best.score
        assert told.regret == 0.0
        assert told.actions == [action.name for action in best.actions]
        assert told.path == [flown("hard", 7, i).position for i in range(best.steps + 1)]

    def test_the_episode_is_kept_and_can_be_flown_again(self, client: TestClient, settings: dict[str, Any]) -> None:
        _, last = finish(client, "medium", 9)
        summary = client.get("/memory_logs").json()["episodes"][0]
        assert (summary["task"], summary["agent"], summary["success"]) == ("medium_delivery", "tester", True)
        assert (summary["score"], summary["reward_total"]) == (last["score"], last["reward_total"])
        with Store(settings["data"]) as store:
            stored = store.episode(summary["id"])
        assert replay(stored.record).score == last["score"]
        analysis = client.get("/analyse/medium").json()
        assert (analysis["episodes_total"], analysis["success_rate"], analysis["deliveries"]) == (1, 1.0, 3)

    def test_the_grade_is_the_graders(self, client: TestClient) -> None:
        session, last = finish(client, "easy", 3)
        state = client.get("/state", headers=session).json()
        answer = client.get("/grade/easy_delivery", headers=session).json()
        assert answer == {"task": "easy_delivery", "score": last["score"], "done": True}
        assert GRADERS["easy_delivery"](DroneState.model_validate(state)) == last["score"]

    def test_the_grade_of_another_task_is_refused(self, client: TestClient, session: Header) -> None:
        answer = client.get("/grade/hard", headers=session)
        assert (answer.status_code, answer.json()["code"]) == (409, "other_task")
        assert client.get("/grade/none", headers=session).status_code == 404


class TestEndOfSession:
    def test_a_session_that_is_ended_is_gone_and_its_place_free(self, tmp_path: Path) -> None:
        with TestClient(create_app(Settings(data=tmp_path, capacity=1))) as client:
            header = {"X-Session-Id": client.post("/reset").json()["session_id"]}
            client.cookies.clear()
            assert client.post("/reset").status_code == 503
            assert client.delete("/session", headers=header).status_code == 204
            assert client.delete("/session", headers=header).status_code == 410
            assert client.get("/state", headers=header).status_code == 410
            assert client.post("/reset").status_code == 200

    def test_the_cookie_goes_with_it(self, tmp_path: Path) -> None:
        with TestClient(create_app(Settings(data=tmp_path))) as client:
            client.post("/reset")
            assert client.delete("/session").status_code == 204
            assert client.get("/state").json()["code"] == "no_session"

    def test_the_client_ends_its_session(self, tmp_path: Path) -> None:
        with TestClient(create_app(Settings(data=tmp_path, capacity=1))) as client:
            for seed in range(3):
                with DroneEnvClient(http=client) as drone:
                    drone.reset(seed=seed)
                    assert drone.session_id is not None
                client.cookies.clear()

    def test_finished_sessions_give_way_when_nobody_has_used_them_for_a_while(
        self, tmp_path: Path, clock: Clock
    ) -> None:
        with TestClient(create_app(Settings(data=tmp_path, capacity=2), clock)) as client:
            sessions: list[dict[str, str]] = []
            for _ in range(2):
                client.cookies.clear()
                sessions.append({"X-Session-Id": client.post("/reset", json={"seed": 7}).json()["session_id"]})
            while not client.post("/step", headers=sessions[0], json={"direction": "WAIT"}).json()["done"]:
                pass
            client.cookies.clear()
            clock.now += 29
            assert client.post("/reset").status_code == 503  # its owner may still ask for the score
            clock.now += 1
            assert client.post("/reset").status_code == 200
            assert client.get("/state", headers=sessions[0]).status_code == 410
            assert client.get("/state", headers=sessions[1]).status_code == 200


def test_a_store_that_fails_is_told_as_busy_and_keeps_nothing(
    client: TestClient, session: Header, settings: dict[str, Any]
) -> None:
    with sqlite3.connect(settings["data"] / FILE_NAME) as other:
        other.execute(
            "CREATE TRIGGER broken BEFORE UPDATE ON sessions BEGIN SELECT RAISE(ABORT, 'the disk is gone'); END"
        )
    for method, path, body in (("POST", "/step", {"direction": "UP"}), ("POST", "/reset", {"seed": 8})):
        answer = client.request(method, path, json=body, headers=session)
        assert (answer.status_code, answer.json()["code"]) == (503, "store")
        assert "the disk is gone" in answer.json()["detail"]
        assert answer.headers["Retry-After"] == "5"
    with sqlite3.connect(settings["data"] / FILE_NAME) as other:
        other.execute("DROP TRIGGER broken")
    other.close()
    state = client.get("/state", headers=session).json()
    assert (state["seed"], state["step_count"]) == (7, 0)
    # What was flown before the failure is not flown twice.
    assert client.post("/step", json={"direction": "UP"}, headers=session).json()["step_count"] == 1


def test_a_session_of_a_task_that_a_newer_version_has_made_is_told(
    client: TestClient, session: Header, settings: dict[str, Any]
) -> None:
    with sqlite3.connect(settings["data"] / FILE_NAME) as newer:
        newer.execute("UPDATE sessions SET task_version = 99")
    newer.close()
    for answer in (client.get("/state", headers=session), client.post("/step", json=UP, headers=session)):
        assert (answer.status_code, answer.json()["code"]) in ((404, "unknown_name"), (422, "unknown_name"))
        assert "99" in answer.json()["detail"]
    assert client.post("/reset", json={"seed": 7}, headers=session).json()["step_count"] == 0
    assert client.get("/state", headers=session).status_code == 200


def test_what_a_reset_answers_can_be_asked_about(client: TestClient) -> None:
    observation = client.post("/reset", json={"seed": 7}).json()
    own = client.post("/predict", headers={"X-Session-Id": observation["session_id"]}).json()
    assert client.post("/predict", json=observation).json() == own
