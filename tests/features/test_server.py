"""The promises of the server, as any HTTP client sees them."""

import json
import re
import subprocess
import sys
from collections.abc import Generator
from importlib import import_module
from pathlib import Path
from typing import Any

import httpx
import pytest

import drone_env
from drone_env import DroneObservation, DroneState
from tests.api.serving import ROOT, Server, serving
from tests.tools import find_uv

EXAMPLE = """
from drone_env.client import DroneEnvClient

with DroneEnvClient("http://localhost:8000") as client:
    # Check server health
    print(client.health())

    # Run a random episode for smoke-testing
    result = client.run_random_episode("easy_delivery", verbose=True)
    print(f"Score: {result['score']:.4f}")

    # Manual episode loop
    obs = client.reset("hard_delivery")
    while not obs["done"]:
        obs = client.step("RIGHT")   # or UP / DOWN / LEFT / WAIT

    analytics = client.analyse("hard_delivery")
    print(analytics)
"""
"""As the first description of the project had it."""
RUN_UV = """
import os, sys
uv, environment, run, *rest = sys.argv[1:]
os.environ["UV_PROJECT_ENVIRONMENT"] = environment
os.execv(uv, [uv, run, "--no-sync", *rest])
"""
BEST = ("LEFT", "UP", "UP")
"""The best flight over easy map 14."""


@pytest.fixture
def http(server: Server) -> Generator[httpx.Client, None, None]:
    """A client that keeps the cookie of its session, as browsers do."""
    with httpx.Client(base_url=server.url, timeout=30) as client:
        yield client


@pytest.fixture
def flying(http: httpx.Client) -> httpx.Client:
    """The same, at the start of easy map 14."""
    assert http.post("/reset", json={"task_name": "easy_delivery", "seed": 14}).status_code == 200
    return http


def get(http: httpx.Client, path: str) -> Any:
    answer = http.get(path)
    assert answer.status_code == 200, answer.text
    return answer.json()


def fly(http: httpx.Client, *directions: str) -> dict[str, Any]:
    for direction in directions:
        answer = http.post("/step", json={"direction": direction})
        assert answer.status_code == 200, answer.text
    return answer.json()


@pytest.mark.feature("H1")
def test_h1_post_reset(http: httpx.Client) -> None:
    """POST /reset starts an episode of a task on the map of a seed, and answers a DroneObservation"""
    answer = http.post("/reset", json={"task_name": "easy_delivery", "seed": 14})
    assert answer.status_code == 200
    fields = answer.json()
    fields.pop("session_id")
    observation = DroneObservation.model_validate_json(json.dumps(fields))
    assert (observation.drone_x, observation.drone_y, observation.current_target) == (6, 3, (5, 1))
    assert (observation.step_count, observation.max_steps, observation.battery, observation.done) == (0, 60, 1, False)
    assert http.post("/reset", json={"task_name": "nowhere"}).status_code in (404, 422)


@pytest.mark.feature("H2")
def test_h2_post_step(flying: httpx.Client) -> None:
    """POST /step flies one action and answers a DroneObservation"""
    observation = DroneObservation.model_validate_json(json.dumps(fly(flying, "LEFT")))
    assert (observation.drone_x, observation.drone_y, observation.reward_last) == (5, 3, 0.15)
    last = fly(flying, "UP", "UP")
    assert (last["done"], last["deliveries_done"], last["reward_last"], last["score"]) == (True, 1, 0.99, 0.99)
    assert flying.post("/step", json={"direction": "SIDEWAYS"}).status_code == 422


@pytest.mark.feature("H3")
def test_h3_get_state(flying: httpx.Client) -> None:
    """GET /state tells the full DroneState of the session's episode"""
    fly(flying, "LEFT", "UP")
    state = DroneState.model_validate_json(flying.get("/state").content)
    assert (state.task_name, state.seed, state.drone_x, state.drone_y) == ("easy_delivery", 14, 5, 2)
    assert (state.step_count, state.battery_steps_remaining, state.outcome) == (2, 58, "flying")


@pytest.mark.feature("H4")
def test_h4_get_grade(flying: httpx.Client) -> None:
    """GET /grade/{task_name} grades the session's episode"""
    fly(flying, *BEST)
    grade = get(flying, "/grade/easy_delivery")
    assert (grade["task"], grade["score"]) == ("easy_delivery", 0.99)
    assert flying.get("/grade/nowhere").status_code == 404


@pytest.mark.feature("H5")
def test_h5_get_analyse(http: httpx.Client) -> None:
    """GET /analyse/{task_name} sums up the stored history: reward, success and its trend, steps, deliveries, actions"""
    # Nobody else here flies medium: what is stored is what the fixture put there.
    records = [get(http, f"/episodes/{one['id']}") for one in get(http, "/episodes?task=medium_delivery")["episodes"]]
    wins = [record["success"] for record in records]
    actions = [action for record in records for action in record["actions"]]
    told = get(http, "/analyse/medium_delivery")
    assert (len(records), told["episodes"]) == (9, 9)
    assert told["success_rate"] == pytest.approx(sum(wins) / 9)
    assert told["success_trend"] == pytest.approx((sum(wins[:4]) - sum(wins[5:])) / 4)
    assert told["average_steps"] == pytest.approx(len(actions) / 9)
    assert told["deliveries"] == sum(record["deliveries"] for record in records) >= 18
    listed = get(http, "/episodes?task=medium_delivery")["episodes"]
    assert told["average_reward"] == pytest.approx(sum(one["reward_total"] for one in listed) / 9)
    assert sum(told["action_distribution"].values()) == pytest.approx(1)
    assert told["action_distribution"]["WAIT"] == pytest.approx(actions.count("WAIT") / len(actions))


@pytest.mark.feature("H6")
def test_h6_get_path_history(flying: httpx.Client) -> None:
    """GET /path_history tells the episode's trajectory, step by step"""
    fly(flying, *BEST)
    path = get(flying, "/path_history")["path"]
    assert [(at["step"], at["action"], at["x"], at["y"], at["reward"]) for at in path] == [
        (1, "LEFT", 5, 3, 0.15),
        (2, "UP", 5, 2, 0.15),
        (3, "UP", 5, 1, 0.99),
    ]


@pytest.mark.feature("H7")
def test_h7_get_memory_logs(flying: httpx.Client) -> None:
    """GET /memory_logs tells the last 5 finished episodes"""
    fly(flying, *BEST)
    newest, *others = get(flying, "/memory_logs")["episodes"]
    assert len(others) == 4
    assert (newest["task"], newest["seed"], newest["steps"], newest["success"]) == ("easy_delivery", 14, 3, True)
    assert newest["reward_total"] == pytest.approx(1.29)


@pytest.mark.feature("H8")
def test_h8_get_logs(http: httpx.Client, server: Server) -> None:
    """GET /logs tells the last 50 lines of the training log, data/train.log"""
    log = server.data / "train.log"
    log.write_text("".join(f"episode={i}\n" for i in range(200)), encoding="utf-8")
    assert get(http, "/logs")["lines"] == [f"episode={i}" for i in range(150, 200)]


@pytest.mark.feature("H9")
def test_h9_get_terminal_logs(http: httpx.Client) -> None:
    """GET /terminal_logs tells the HTTP requests: as JSON, or live as server-sent events"""
    assert http.get("/nowhere-to-be-found").status_code == 404
    last = get(http, "/terminal_logs")["requests"][-1]
    assert (last["method"], last["path"], last["status"]) == ("GET", "/nowhere-to-be-found", 404)
    with http.stream("GET", "/terminal_logs", headers={"Accept": "text/event-stream"}) as live:
        assert live.headers["Content-Type"].startswith("text/event-stream")
        http.get("/health?while=listening")
        lines = (json.loads(line[6:]) for line in live.iter_lines() if line.startswith("data: "))
        assert next(one for one in lines if one["number"] > last["number"] + 1)["path"] == "/health"


@pytest.mark.feature("H10")
def test_h10_get_tasks_and_graders(http: httpx.Client) -> None:
    """GET /tasks and GET /graders tell the tasks with their numbers, and the graders"""
    tasks = {task["id"]: task for task in get(http, "/tasks")["tasks"]}
    hard = tasks["hard_delivery"]
    assert (hard["width"], hard["deliveries"], hard["max_steps"], hard["r_delivery"]) == (18, 5, 160, 0.85)
    graders = [grader["id"] for grader in get(http, "/graders")["graders"]]
    assert graders[:3] == [f"drone_env.graders:grade_{level}" for level in ("easy", "medium", "hard")]
    assert [task["grader"] for task in tasks.values()] == graders
    for grader in graders:
        module, _, name = grader.partition(":")
        assert callable(getattr(import_module(module), name))


@pytest.mark.feature("H11")
def test_h11_get_health(http: httpx.Client) -> None:
    """GET /health says that the server is healthy, and its version"""
    assert get(http, "/health") == {"status": "healthy", "version": drone_env.__version__}


@pytest.mark.feature("H12")
def test_h12_get_the_dashboard(http: httpx.Client) -> None:
    """GET / is the dashboard, and all its files are there"""
    page = http.get("/")
    assert page.headers["Content-Type"] == "text/html; charset=utf-8"
    assert "Drone Delivery" in page.text
    files = re.findall(r'(?:src|href)="(static/[^"]+)"', page.text)
    assert any(file.endswith("main.js") for file in files)
    assert {file: http.get(f"/{file}").status_code for file in files} == dict.fromkeys(files, 200)


@pytest.mark.feature("H13")
@pytest.mark.parametrize(
    "command",
    [
        "uv run server",
        "python -m uvicorn server.app:app --host 0.0.0.0",
        "python drone_env/server/app.py --host 0.0.0.0",
    ],
)
def test_h13_three_ways_to_start_it(tmp_path: Path, command: str) -> None:
    """uv run server, python -m uvicorn server.app:app and python drone_env/server/app.py each start the server"""
    first, *rest = command.split()
    if first == "uv":
        # In the environment of the tests, as it is: what `uv run` would install is there.
        rest = ["-c", RUN_UV, find_uv(), sys.prefix, *rest]
    with serving(tmp_path / "data", tuple(rest)) as server:
        assert httpx.get(f"{server.url}/health").json()["status"] == "healthy"
        assert httpx.post(f"{server.url}/reset", json={"seed": 14}).status_code == 200


@pytest.mark.feature("H14")
def test_h14_the_python_client(server: Server) -> None:
    """DroneEnvClient drives it from Python, and python -m drone_env.client URL flies a smoke mission"""

    def run(*arguments: str) -> str:
        command = [sys.executable, *arguments]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=120)
        assert done.returncode == 0, done.stderr
        return done.stdout

    health, *steps, score, analytics = run("-c", EXAMPLE.replace("http://localhost:8000", server.url)).splitlines()
    assert "'status': 'healthy'" in health
    assert steps
    assert all(line.startswith(f"step {number}: ") for number, line in enumerate(steps, start=1))
    assert re.fullmatch(r"Score: 0\.\d{4}", score)
    assert "'task': 'hard_delivery'" in analytics
    assert re.search(r"^score: 0\.\d{4} in \d+ steps$", run("-m", "drone_env.client", server.url), re.MULTILINE)
