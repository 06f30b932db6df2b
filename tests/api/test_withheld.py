"""A server that withholds hints: no route shows how to fly a map better."""

from pathlib import Path

from starlette.testclient import TestClient

from drone_env.planning.optimal import solve
from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from tests.test_api import BODIES

SERVED = {
    *("/reset", "/step", "/state", "/session", "/path_history", "/grade/{task_name}", "/health", "/metadata"),
    *("/schema", "/mcp", "/graders", "/kinds", "/tasks", "/tasks/{task_name}", "/list_environments"),
    *("/drone-env/splits", "/drone-env/tasks", "/drone-env/num_tasks", "/drone-env/task", "/drone-env/task_range"),
}
"""All other routes may show a better flight."""


def test_no_route_shows_a_hint(tmp_path: Path) -> None:
    best = solve("hard", 7)
    with TestClient(create_app(Settings(data=tmp_path, withhold_hints=True))) as client:
        bodies = BODIES | {"/reset": {"task_name": "hard", "seed": 7}}
        named = {"Mcp-Session-Id": client.post("/reset", headers={"X-Session-Id": "new"}).json()["session_id"]}
        client.cookies.clear()
        client.post("/reset", json=bodies["/reset"])
        described = client.get("/openapi.json").json()["paths"]
        assert set(described) > SERVED
        pages = [("get", path) for path in ("/", "/docs", "/static/js/learn.js", "/values/", "//values", "/none")]
        routes = [(method, path) for path, methods in described.items() for method in methods]
        for method, path in sorted([*routes, *pages], reverse=True):
            filled = path.format(task_name="hard", seed=7, episode_id="0" * 16)
            answer = client.request(method, filled, json=bodies.get(path), headers=named)
            if path in SERVED:
                assert answer.status_code in (200, 204), (method, path, answer.text)
                assert str(best.score) not in answer.text
            else:
                assert (answer.status_code, answer.json()["code"]) == (403, "withheld"), (method, path)
        with client.websocket_connect("/ws") as socket:
            socket.send_json({"type": "reset", "data": {"task_name": "hard", "seed": 7, "prompt": "minimal"}})
            answers = [socket.receive_json()["data"]]
            for action in best.actions:
                socket.send_json({"type": "step", "data": {"direction": action.name}})
                answers.append(socket.receive_json()["data"])
            assert not [answer for answer in answers[:-1] if str(best.score) in str(answer)]
            assert answers[-1]["reward"] == best.score
