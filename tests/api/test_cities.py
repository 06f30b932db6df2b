"""A city on a server that was told of it by its file."""

from collections.abc import Iterator
from pathlib import Path

import gymnasium
import pytest
from starlette.testclient import TestClient

from drone_env.city.city_file import write_city
from drone_env.city.importer import import_city
from drone_env.core.tasks import TASKS
from drone_env.envs.registry import load_plugins
from drone_env.graders import GRADERS
from drone_env.planning.optimal import solve
from tests.api.live_page import Page

HELSINKI = Path(__file__).parents[2] / "examples" / "cities" / "helsinki.osm.pbf"


@pytest.fixture
def station(tmp_path: Path) -> Iterator[str]:
    """The square before Helsinki's station, 20 x 20 cells."""
    city = import_city(HELSINKI, size=(20, 20)).city
    write_city(city, tmp_path / "station.toml")
    load_plugins(str(tmp_path / "station.toml"))
    yield "station"
    task = TASKS.pop("station")
    del GRADERS["station"], gymnasium.registry[task.gym_id]


def test_a_city_is_flown_over_http_and_on_the_page(station: str, client: TestClient) -> None:
    listed = next(task for task in client.get("/tasks").json()["tasks"] if task["id"] == station)
    assert (listed["width"], listed["family"]) == (20, "city")
    assert listed["attribution"] == "© OpenStreetMap contributors"
    reset = client.post("/reset", json={"task_name": station, "seed": 7}).json()
    session = {"X-Session-Id": reset["session_id"]}
    last = reset
    best = solve(station, 7)
    for action in best.actions:
        last = client.post("/step", json={"direction": action.name}, headers=session).json()
    assert last["done"]
    grade = client.get(f"/grade/{station}", headers=session).json()
    assert grade == {"task": station, "score": best.score, "done": True}
    assert client.get("/solution", headers=session).json()["regret"] == 0
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start("tournet", "greedy", "optimal", task=station)
        page.send("play", speed=60)
        flown = page.flight()
        assert flown[2][-1]["score"] == best.score
    assert client.get(f"/preview.png?task={station}&seed=7&pilot=greedy").status_code == 200
