"""The HTTP interface: requests to every endpoint, with a session cookie as in a browser."""

import re
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient

import drone_env
from drone_env.server.app import create_app
from drone_env.server.routes.replay import RECORD
from drone_env.server.settings import Settings

BEST = ("LEFT", "UP", "UP")
"""The best flight over easy map 14."""


@pytest.fixture
def http(tmp_path: Path) -> Generator[TestClient, None, None]:
    with TestClient(create_app(Settings(data=tmp_path / "data"))) as client:
        yield client


def get(http: TestClient, path: str) -> Any:
    return http.get(path).raise_for_status().json()


def fly(http: TestClient, *directions: str) -> dict[str, Any]:
    answer: dict[str, Any] = {}
    for direction in directions:
        answer = http.post("/step", json={"direction": direction}).raise_for_status().json()
    return answer


@pytest.mark.feature("H1", "H2", "H3", "H4", "H6")
def test_a_flight_by_hand(http: TestClient) -> None:
    fields = http.post("/reset", json={"task_name": "easy_delivery", "seed": 14}).json()
    assert (fields["drone_x"], fields["drone_y"], fields["current_target"]) == (6, 3, [5, 1])
    fly(http, "LEFT", "UP")
    assert get(http, "/state")["episode_id"] is None
    last = fly(http, "UP")
    assert (last["done"], last["deliveries_done"], last["reward_last"], last["score"]) == (True, 1, 0.99, 0.99)
    assert get(http, "/grade/easy_delivery") == {"task": "easy_delivery", "score": 0.99, "done": True}
    after = fly(http, "UP")
    assert after == {**last, "message": after["message"], "reward_last": 0}
    assert after["message"].startswith("Nothing done")
    assert get(http, "/state")["episode_id"] == get(http, "/memory_logs")["episodes"][0]["id"]
    path = get(http, "/path_history")["path"]
    flown = [(at["step"], at["action"], at["x"], at["y"], at["reward"]) for at in path]
    assert flown == [(1, "LEFT", 5, 3, 0.15), (2, "UP", 5, 2, 0.15), (3, "UP", 5, 1, 0.99)]


@pytest.mark.feature("H8", "L6")
def test_get_logs(http: TestClient, tmp_path: Path) -> None:
    assert get(http, "/logs") == {"file": "train.log", "lines": []}
    log = tmp_path / "data" / "train.log"
    log.write_text("".join(f"episode={i}\n" for i in range(200)), encoding="utf-8")
    assert get(http, "/logs")["lines"] == [f"episode={i}" for i in range(150, 200)]


@pytest.mark.feature("H10")
def test_get_tasks_and_graders(http: TestClient) -> None:
    tasks = {task["id"]: task for task in get(http, "/tasks")["tasks"]}
    assert list(tasks) == [task["name"] for task in tasks.values()]
    assert list(tasks) == list(drone_env.TASKS)
    for task_id, task in drone_env.TASKS.items():
        for name in ("width", "deliveries", "max_steps", "r_delivery", "r_wall", "version", "grader", "family"):
            assert tasks[task_id][name] == getattr(task, name)
    assert [tasks[name]["buildings"] for name in ("easy_delivery", "city_small")] == [4, None]
    answer = get(http, "/graders")
    graders = answer["graders"]
    assert answer["ids"] == [grader["id"] for grader in graders]
    assert graders == [{"id": task["grader"], "task": task_id} for task_id, task in tasks.items()]
    assert [one["id"] for one in graders[:3]] == [f"drone_env.graders:grade_{n}" for n in ("easy", "medium", "hard")]


@pytest.mark.feature("H11")
def test_get_health(http: TestClient) -> None:
    assert get(http, "/health") == {"status": "healthy", "version": drone_env.__version__}
    assert http.head("/health").status_code == 200


@pytest.mark.feature("H12")
def test_get_the_dashboard(http: TestClient) -> None:
    page = http.get("/")
    assert (page.status_code, page.headers["Content-Type"]) == (200, "text/html; charset=utf-8")
    assert "Drone Delivery" in page.text
    files = re.findall(r'(?:src|href)="(static/[^"]+)"', page.text)
    assert any(file.endswith("main.js") for file in files)
    for file in files:
        found = http.get(f"/{file}")
        assert (found.status_code, found.headers["Cache-Control"]) == (200, "no-cache"), file
        assert http.get(f"/{file}", headers={"If-None-Match": found.headers["ETag"]}).status_code == 304
    assert http.get("/static/nothing.js").status_code == 404
    assert http.get("/docs").status_code == 200


SPLIT = {"split": "easy_delivery/test"}
DRAWN = {"cells": [[0, 0], [0, 0]], "start": [0, 0], "parcels": [[1, 1]]}
CITY = 'format = 1\nparcels = [[1, 1]]\n[terrain]\nrows = ["· · ", "· · "]'
BODIES: dict[str, Any] = {
    "/step": {"direction": "LEFT"},
    "/replay": RECORD.model_dump(),
    "/values": {"task": "easy", "seed": 7, "actions": ["UP"]},
    "/flights": {"task": "easy", "seed": 7, "pilots": ["greedy"]},
    "/flights/agent": {"task": "easy", "seed": 7, "pilot": "greedy"},
    "/maps/file": {"toml": CITY},
    "/maps/worth": DRAWN,
    "/maps": DRAWN,
    "/mcp": {"jsonrpc": "2.0", "id": 1, "method": "tools/list"},
    "/drone-env/tasks": SPLIT,
    "/drone-env/num_tasks": SPLIT,
    "/drone-env/task": {**SPLIT, "index": 0},
    "/drone-env/task_range": {**SPLIT, "start": 0, "stop": 1},
}
QUERIES = {
    "/leaderboard/{task_name}/maps": {"agent": "anonymous"},
    "/paired/{task_name}": {"a": "anonymous", "b": "anonymous"},
}


@pytest.mark.feature("P6")
def test_every_endpoint_there_is_answers(http: TestClient) -> None:
    described = get(http, "/openapi.json")["paths"]
    routes = {(method, path) for path, methods in described.items() for method in methods}
    assert http.post("/reset", json={"task_name": "easy_delivery", "seed": 14}).status_code == 200
    assert http.post("/predict").status_code == 200
    fly(http, *BEST)
    episode = get(http, "/episodes")["episodes"][0]["id"]
    page = http.post("/flights", json={"task": "easy", "seed": 7, "pilots": ["human"]}).json()["flights"][0]
    change = {"version": page["version"], "change": "UP"}
    bodies = BODIES | {"/annotate": get(http, f"/episodes/{episode}"), "/flights/change": change}
    ends = {("delete", "/mcp"), ("delete", "/session")}
    for method, path in sorted(routes - ends - {("post", "/predict"), ("post", "/reset")}):
        filled = path.format(task_name="easy", seed=7, episode_id=episode)
        headers = {"X-Session-Id": page["opening"]["session"]} if path == "/flights/change" else None
        answer = http.request(method, filled, json=bodies.get(path), params=QUERIES.get(path), headers=headers)
        assert answer.status_code == 200, (method, path, answer.text)
    assert http.delete("/session").status_code == 204
    begun = http.post("/mcp", json={"jsonrpc": "2.0", "id": 1, "method": "initialize"}).headers
    assert http.delete("/mcp", headers={"Mcp-Session-Id": begun["Mcp-Session-Id"]}).status_code == 204
