"""Maps that are drawn: what they are worth, and how they are kept."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from drone_env.city.city_file import City, city_text, read_city, write_city
from drone_env.city.city_task import city_task
from drone_env.core.tasks import get_task
from drone_env.errors import UnknownNameError
from drone_env.planning.optimal import solve
from drone_env.server.app import create_app
from drone_env.server.settings import Settings
from tests.api.live_page import Page

YARD: dict[str, Any] = {
    "cells": [[0, 1, 0, 0], [0, 3, 0, 8], [0, 0, 2, 0]],
    "start": [0, 0],
    "parcels": [[2, 0], [3, 2]],
    "numbers": {"battery_capacity": 9},
    "attribution": "© OpenStreetMap contributors",
}


def answer(client: TestClient, path: str, body: dict[str, Any]) -> Any:
    answered = client.post(path, json=body)
    assert answered.status_code == 200, answered.text
    return answered.json()


def test_a_drawing_is_worth_what_its_file_is(client: TestClient, tmp_path: Path) -> None:
    told = answer(client, "/maps/worth", YARD)
    file = tmp_path / f"{told['name']}.toml"
    file.write_text(told["toml"], encoding="utf-8")
    write_city(read_city(file), tmp_path / "again.toml")
    assert (tmp_path / "again.toml").read_bytes() == file.read_bytes()
    task = city_task(file)
    best = solve(task, 0)
    assert told["optimum"].pop("path")[0] == YARD["start"]
    assert told["optimum"] == {"score": best.score, "success": True, "deliveries": 2, "steps": best.steps}
    assert told["numbers"] == {"battery_capacity": 9, "max_steps": 35, "charge_rate": 5}
    assert (told["bounds"], task.terrain and task.terrain.attribution) == (None, YARD["attribution"])
    empty = {**YARD, "cells": [[0, 1, 0, 0], [0, 3, 0, 0], [0, 0, 2, 0]], "numbers": {"battery_capacity": 4}}
    assert answer(client, "/maps/worth", empty)["optimum"]["success"] is False
    opened = answer(client, "/maps/file", {"toml": told["toml"]})
    assert answer(client, "/maps/worth", opened)["name"] == told["name"]


def test_any_map_can_be_drawn_on(client: TestClient) -> None:
    drawn = client.get("/maps/skyline_medium/43").json()
    best = solve("skyline_medium", 43)
    assert answer(client, "/maps/worth", drawn)["optimum"]["score"] == best.score
    half = 'format = 1\nlicence = "CC0-1.0"\n[task]\ndeliveries = 2\n[terrain]\nrows = ["· · 🏢", "· 🚧🔋", "· · · "]'
    drawn = answer(client, "/maps/file", {"toml": half})
    assert (len(drawn["parcels"]), drawn["licence"], drawn["numbers"]) == (2, "CC0-1.0", {})
    largest = np.ones((128, 128), np.uint8)
    largest[0, :2] = 0
    drawn = answer(client, "/maps/file", {"toml": city_text(City(largest, start=(0, 0), parcels=((1, 0),)))})
    assert drawn["cells"] == largest.tolist()


@pytest.mark.parametrize(
    ("change", "detail"),
    [
        ({"cells": []}, "rows of equal width"),
        ({"cells": [[0, 0], [0]]}, "rows of equal width"),
        ({"cells": [[0, 4], [0, 0]]}, "0 road, 1 building, 2 tree, 3 obstacle, 8 pad; got 4"),
        ({"cells": [[0] * 129] * 3}, "cells.0: List should have at most 128 items"),
        ({"start": [1, 1]}, "start [1, 1] must be on a road, there is an obstacle"),
        ({"start": [0, 0], "parcels": [[0, 0]]}, "parcel 0 is where start is"),
        ({"cells": [[0, 3, 0, 0], [0, 3, 0, 8], [0, 3, 2, 0]]}, "parcel 0 [2, 0] cannot be reached from start"),
        ({"parcels": []}, "at least 1 item"),
        ({"numbers": {"max_steps": 0}}, "max_steps must be 1 to 32000, got 0"),
        ({"numbers": {"deliveries": 2}}, "deliveries"),
        ({"attribution": "a\nb"}, "attribution must be printable"),
    ],
)
def test_a_bad_drawing_is_refused_with_what_is_allowed(
    shared_client: TestClient, change: dict[str, Any], detail: str
) -> None:
    for path in ("/maps/worth", "/maps"):
        refused = shared_client.post(path, json={**YARD, **change})
        assert refused.status_code == 422
        assert detail in refused.json()["detail"]
    refused = shared_client.post("/maps/file", json={"toml": "format = 2"})
    assert (refused.status_code, refused.json()["detail"]) == (422, "format must be 1, got 2")


def test_a_kept_map_is_flown_stored_and_found_after_a_restart(client: TestClient, settings: dict[str, Any]) -> None:
    told = answer(client, "/maps/worth", YARD)
    with pytest.raises(UnknownNameError, match=told["name"]):
        get_task(told["name"])
    kept = answer(client, "/maps", YARD)
    task = kept["task"]["id"]
    assert (task, kept["pilots"][:2]) == (told["name"], ["tournet", "greedy"])
    assert answer(client, "/maps", YARD) == kept
    files = list((settings["data"] / "maps").iterdir())
    assert [(file.name, file.read_text(encoding="utf-8")) for file in files] == [(f"{task}.toml", told["toml"])]
    assert task not in [known["id"] for known in client.get("/tasks").json()["tasks"]]
    with client.websocket_connect("/live") as socket:
        page = Page(socket)
        page.start("optimal", task=task, seed=0)
        page.send("play", speed=60)
        assert page.flight()[0][-1]["score"] == told["optimum"]["score"]
    with TestClient(create_app(Settings(**settings))) as again:
        [flown] = again.get("/episodes").json()["episodes"]
        assert (flown["task"], flown["score"]) == (task, told["optimum"]["score"])
        record = again.get(f"/episodes/{flown['id']}").json()
        assert answer(again, "/replay", record)["opening"]["start"] == YARD["start"]
        assert again.get(f"/tasks/{task}").json() == kept
        assert again.get(f"/preview.png?task={task}&seed=0&pilot=greedy").status_code == 200
        session = {"X-Session-Id": answer(again, "/reset", {"task_name": task, "seed": 0})["session_id"]}
        assert again.get(f"/grade/{kept['task']['grader']}", headers=session).json()["task"] == task


def test_no_more_are_kept_than_the_server_has_room_for(settings: dict[str, Any]) -> None:
    few = Settings(**settings, maps=1)
    with TestClient(create_app(few)) as client:
        kept = answer(client, "/maps", YARD)
        refused = client.post("/maps", json={**YARD, "start": [0, 2]})
        assert (refused.status_code, refused.json()["code"]) == (503, "no_room")
        assert answer(client, "/maps", YARD) == kept
    # What a hand has changed is another map, which is not flown by the name of this one.
    file = few.data / "maps" / f"{kept['task']['id']}.toml"
    write_city(City(read_city(file).grid), file)
    with TestClient(create_app(few)) as again:
        assert again.get(f"/tasks/{file.stem}").status_code == 404
