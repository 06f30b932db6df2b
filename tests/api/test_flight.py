"""Flying over HTTP: reset, step, and what there is to know about an episode."""

from typing import Any

import pytest
from starlette.testclient import TestClient

from drone_env.core.episode import Episode
from drone_env.core.tasks import TASKS
from drone_env.models import DroneObservation, DroneState
from drone_env.planning.optimal import solve
from drone_env.server.routes.flight import FlatReset, PathHistory

Header = dict[str, str]
UP = {"direction": "UP"}


def flown(task: str, seed: int, actions: int = 0) -> Episode:
    """An episode after the first actions of the best flight."""
    return Episode(task, "tiered", seed).fly(solve(task, seed).actions[:actions])


@pytest.mark.feature("E5", "H1", "H2", "H3", "H4", "H6")
@pytest.mark.parametrize("task", TASKS)
def test_every_task_is_flown_as_the_rules_say(shared_client: TestClient, task: str) -> None:
    body = shared_client.post("/reset", json={"task_name": task, "seed": 3}).json()
    session = {"X-Session-Id": body["session_id"]}
    episode = flown(task, 3)
    assert (
        FlatReset.model_validate(body).model_dump(exclude={"session_id"}) == DroneObservation.of(episode).model_dump()
    )
    for direction in ("UP", "LEFT", "WAIT", "DOWN", "RIGHT", "UP"):
        answer = shared_client.post("/step", json={"direction": direction}, headers=session)
        episode.step(["UP", "DOWN", "LEFT", "RIGHT", "WAIT"].index(direction))
        assert answer.status_code == 200
        assert DroneObservation.model_validate(answer.json()) == DroneObservation.of(episode)
    assert DroneState.model_validate(shared_client.get("/state", headers=session).json()) == DroneState.of(episode)
    history = PathHistory.model_validate(shared_client.get("/path_history", headers=session).json())
    assert history.path == DroneState.of(episode).path_history
    grade = shared_client.get(f"/grade/{task}", headers=session).json()
    assert grade == {"task": task, "score": episode.score, "done": False}


@pytest.mark.parametrize(
    ("path", "body", "told"),
    [
        ("/step", {}, "body.direction: Field required"),
        ("/step", {"direction": "up"}, "body.direction"),
        ("/step", {"direction": "UP", "speed": 2}, "body.speed"),
        ("/step", [], "body: Input should be"),
        ("/reset", {"task_name": "none"}, "allowed: city, city_small, easy, hard"),
        ("/reset", {"reward_profile": "none"}, "allowed: aligned"),
        ("/reset", {"seed": "7"}, "body.seed"),
        ("/reset", {"agent": "two\nlines"}, "one printable line"),
        ("/reset", {"split": "easy_delivery/nowhere", "index": 1}, "easy_delivery/test"),
        ("/reset", {"split": "easy_delivery/test", "index": 2**51}, "there is no number"),
    ],
)
def test_what_is_refused_leaves_the_episode_as_it_was(
    shared_client: TestClient, path: str, body: Any, told: str
) -> None:
    session = {"X-Session-Id": shared_client.post("/reset", json={"seed": 7}).json()["session_id"]}
    shared_client.post("/step", json=UP, headers=session)
    answer = shared_client.post(path, json=body, headers=session)
    assert answer.status_code == 422
    assert told in answer.json()["detail"]
    assert shared_client.get("/state", headers=session).json()["step_count"] == 1


def test_a_reset_in_a_session_stays_in_it_and_walks_on(client: TestClient, session: Header) -> None:
    answer = client.post("/reset", headers=session)
    walk = flown("easy_delivery", 7)
    assert answer.json()["session_id"] == session["X-Session-Id"] == answer.headers["X-Session-Id"]
    assert client.get("/state", headers=session).json()["seed"] == walk.reset()


class TestAfterTheEnd:
    def test_the_grade_of_another_task_is_refused(self, client: TestClient, session: Header) -> None:
        answer = client.get("/grade/hard", headers=session)
        assert (answer.status_code, answer.json()["code"]) == (409, "other_task")
        assert client.get("/grade/none", headers=session).status_code == 404
