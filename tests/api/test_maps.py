"""Maps that are drawn: what they are worth, and how they are kept."""

import asyncio
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from drone_env.city.city_file import City, city_task, city_text, parse_city
from drone_env.core.actions import Action
from drone_env.core.cells import Cell
from drone_env.core.episode import Episode
from drone_env.flights.record import record_of
from drone_env.planning.optimal import solve
from drone_env.server.app import create_app
from drone_env.server.drawn_maps import drawn_task
from drone_env.server.settings import Settings
from tests.api.flying import start

YARD: dict[str, Any] = {
    "cells": [[0, 1, 0, 0], [0, 3, 0, 8], [0, 0, 2, 0]],
    "start": [0, 0],
    "parcels": [[2, 0], [3, 2]],
    "numbers": {"battery_capacity": 9},
    "attribution": "© OpenStreetMap contributors",
}


@pytest.fixture
def settings(tmp_path: Path) -> dict[str, Any]:
    return {"data": tmp_path / "data"}


def answer(client: TestClient, path: str, body: dict[str, Any]) -> Any:
    return client.post(path, json=body).raise_for_status().json()


def test_a_drawing_is_worth_what_its_file_is(client: TestClient, tmp_path: Path) -> None:
    told = answer(client, "/maps/worth", YARD)
    file = tmp_path / f"{told['name']}.toml"
    file.write_text(told["toml"], encoding="utf-8")
    task = city_task(file)
    best = solve(task, 0)
    assert told["optimum"].pop("path")[0] == YARD["start"]
    assert told["optimum"].pop("actions") == [action.name for action in best.actions]
    assert told["optimum"] == {"score": best.score, "success": True, "deliveries": 2, "steps": best.steps}
    assert told["numbers"] == {"battery_capacity": 9, "max_steps": 35, "charge_rate": 5}
    assert (task.terrain and task.terrain.attribution) == YARD["attribution"]
    empty = {**YARD, "cells": [[0, 1, 0, 0], [0, 3, 0, 0], [0, 0, 2, 0]], "numbers": {"battery_capacity": 4}}
    assert answer(client, "/maps/worth", empty)["optimum"]["success"] is False
    opened = answer(client, "/maps/file", {"toml": told["toml"]})
    assert answer(client, "/maps/worth", opened)["name"] == told["name"]


def test_a_flight_over_a_map_that_is_too_large_to_solve_is_explained_without_an_optimum(client: TestClient) -> None:
    cells = np.zeros((20, 20), np.uint8)
    cells[[3, 15], [3, 4]] = Cell.PAD
    parcels = [[column, 19] for column in range(12)]
    numbers = {"max_steps": 400, "battery_capacity": 200}
    drawing = {"cells": cells.tolist(), "start": [0, 0], "parcels": parcels, "numbers": numbers}
    name = answer(client, "/maps", drawing)["task"]["id"]
    city = parse_city(answer(client, "/maps/worth", drawing)["toml"].encode())
    flown = Episode(drawn_task(city, name), seed=0).fly([Action.RIGHT, Action.LEFT] * 100)
    told = answer(client, "/annotate", record_of(flown, "someone").model_dump())
    assert told["unsolved"].startswith(f"the exact values of a map of '{name}' would take")
    assert (told["optimum"], told["moves"], told["rescue_step"]) == (None, [], None)
    assert told["worst"] == {"first": 1, "last": 200, "regret": None, "why": "flew back and forth for 200 steps"}
    assert told["why"] == "Each step costs a unit; a pad was 6 cells away."


def test_any_map_can_be_drawn_on(client: TestClient) -> None:
    drawn = client.get("/maps/skyline_medium/43").json()
    best = solve("skyline_medium", 43)
    assert answer(client, "/maps/worth", drawn)["optimum"]["score"] == best.score
    largest = np.ones((128, 128), np.uint8)
    largest[0, :2] = 0
    drawn = answer(client, "/maps/file", {"toml": city_text(City(largest, start=(0, 0), parcels=((1, 0),)))})
    assert drawn["cells"] == largest.tolist()


@pytest.mark.parametrize(
    ("change", "detail"),
    [
        ({"cells": [[0, 0], [0]]}, "rows of equal width"),
        ({"cells": [[0, 4], [0, 0]]}, "0 road, 1 building, 2 tree, 3 obstacle, 8 pad; got 4"),
        ({"cells": [[0] * 129] * 3}, "cells.0: List should have at most 128 items"),
        ({"start": [1, 1]}, "the start [1, 1] must be on a road"),
        ({"numbers": {"max_steps": 32001}}, "max_steps must be 1 to 32000, got 32001"),
        ({"numbers": {"deliveries": 2}}, "deliveries"),
    ],
)
def test_a_bad_drawing_is_refused_with_what_is_allowed(
    shared_client: TestClient, change: dict[str, Any], detail: str
) -> None:
    for path in ("/maps/worth", "/maps"):
        refused = shared_client.post(path, json={**YARD, **change})
        assert refused.status_code == 422
        assert detail in refused.json()["detail"]


def test_a_kept_map_is_flown_stored_and_found_after_a_restart(client: TestClient, settings: dict[str, Any]) -> None:
    told = answer(client, "/maps/worth", YARD)
    kept = answer(client, "/maps", YARD)
    task = kept["task"]["id"]
    assert (task, kept["pilots"][:2]) == (told["name"], ["tournet", "greedy"])
    assert answer(client, "/maps", YARD) == kept
    files = list((settings["data"] / "maps").iterdir())
    assert [(file.name, file.read_text(encoding="utf-8")) for file in files] == [(f"{task}.toml", told["toml"])]
    (shown,) = start(client, "optimal", task=task, seed=0)
    assert shown["frames"][-1]["score"] == told["optimum"]["score"]
    with TestClient(create_app(Settings(**settings))) as again:
        [flown] = again.get("/episodes").json()["episodes"]
        assert (flown["task"], flown["score"]) == (task, told["optimum"]["score"])
        record = again.get(f"/episodes/{flown['id']}").json()
        assert answer(again, "/replay", record)["opening"]["parcels"] == YARD["parcels"]
        assert again.get(f"/tasks/{task}").json() == kept


def test_a_map_without_its_file_is_unknown_until_it_is_drawn_again(settings: dict[str, Any]) -> None:
    with TestClient(create_app(Settings(**settings))) as client:
        name = answer(client, "/maps", YARD)["task"]["id"]
        session = {"X-Session-Id": answer(client, "/reset", {"task_name": name, "seed": 0})["session_id"]}
    (settings["data"] / "maps" / f"{name}.toml").unlink()
    with TestClient(create_app(Settings(**settings))) as again:
        refused = again.post("/step", json={"direction": "UP"}, headers=session)
        assert (refused.status_code, refused.json()["code"]) == (422, "unknown_name")
        answer(again, "/maps", YARD)
        assert again.post("/step", json={"direction": "UP"}, headers=session).status_code == 200


def test_a_reset_reads_a_drawn_map_off_the_event_loop(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    name = answer(client, "/maps", YARD)["task"]["id"]
    on_loop: list[bool] = []
    maps = client.app.state.shared.maps  # type: ignore[attr-defined]

    def find(file: Path, find: Any = maps._read) -> Any:
        with suppress(RuntimeError):
            on_loop.append(asyncio.get_running_loop() is not None)
        return find(file)

    monkeypatch.setattr(maps, "_read", find)
    with client.websocket_connect("/ws") as socket:
        for data in ({"task_name": name, "seed": 0}, {"split": f"{name}/train", "index": 0}):
            socket.send_json({"type": "reset", "data": data})
            assert socket.receive_json()["type"] == "observation"
    assert client.post("/drone-env/num_tasks", json={"split": f"{name}/test"}).status_code == 200
    assert on_loop == []
